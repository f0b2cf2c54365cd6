"""`About`: origin and rights of an exported component, for its description, its sources and its documentation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from importlib import metadata
from pathlib import Path

from servocore.errors import InvalidSetting
from servocore.model.parameter_files import read_table

DATE = "2026-01-01T00:00:00Z"
"""Of every description: two exports of one model are equal."""

_PNG = b"\x89PNG"
_FILES = {  # endings, and place in an FMU
    "license_text": ((".txt", ".html"), "documentation/licenses/license{}"),
    "icon": ((".png", ".svg"), "terminalsAndIcons/icon{}"),
    "documentation": ((".html",), "documentation/index{}"),
}


def tool() -> str:
    """Return name and version of this package."""
    return f"servocore {metadata.version('servocore')}"


@dataclass(frozen=True)
class About:
    """Origin and rights of an exported component; without values those of this project stand.

    Attributes
    ----------
    version : str
        Of the component.
    author, company : str
        Who made it.
    license, copyright : str
        Short texts, such as ``proprietary`` and ``Copyright 2026 ACME``.
    license_text : str or Path, optional
        A text or HTML file, copied into ``documentation/licenses``.
    description : str
        One line; that of the model when empty.
    icon : str or Path, optional
        A PNG picture, or in FMI 3 an SVG drawing beside the usual picture.
    annotations : mapping of str to mapping of str to str
        Names and values by the name of a tool.
    documentation : str or Path, optional
        An HTML page in the place of ours, which becomes ``documentation/model.html``.
    defaults : mapping of str to str
        Items of enumerations as defaults, for hosts that cannot set them: ``{"input_time": "end"}``.

    Raises
    ------
    InvalidSetting
        If a text is none, or a file cannot be read or is of another kind.
    """

    version: str = ""
    author: str = "The authors of servocore"
    company: str = ""
    license: str = "MIT"
    copyright: str = "Copyright (c) 2026 the servocore authors"
    license_text: str | Path | None = None
    description: str = ""
    icon: str | Path | None = None
    annotations: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    documentation: str | Path | None = None
    defaults: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse values of other kinds."""
        for name in ("version", "author", "company", "license", "copyright", "description"):
            if not isinstance(getattr(self, name), str):
                raise InvalidSetting(f"about: {name} must be a text, not {getattr(self, name)!r}")
        tables = [self.annotations, self.defaults]
        tables += self.annotations.values() if isinstance(self.annotations, Mapping) else []
        if not all(isinstance(table, Mapping) for table in tables):
            raise InvalidSetting(
                "about: annotations are a table for each tool, and defaults a table of items by choice"
            )
        for name, (endings, _) in _FILES.items():
            if (file := getattr(self, name)) is not None:
                if Path(file).suffix.lower() not in endings:
                    raise InvalidSetting(f"about: {name} = {str(file)!r} must end with {' or '.join(endings)}")
                self._content(name)
        if self.icon is not None and Path(self.icon).suffix.lower() == ".png" and self._content("icon")[:4] != _PNG:
            raise InvalidSetting(f"about: {self.icon} is no PNG picture")

    @classmethod
    def from_toml(cls, path: str | Path) -> About:
        """Read a TOML file; its keys are the attributes, and names of files are relative to it.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        About
            Its values.

        Raises
        ------
        InvalidModel, InvalidSetting
            If the file cannot be read, a key is unknown or a value is wrong.
        """
        table, known = read_table(Path(path)), [each.name for each in fields(cls)]
        for key, value in table.items():
            if key not in known:
                raise InvalidSetting(f"{path}: there is no key {key!r}; there are {', '.join(known)}")
            if key in _FILES and isinstance(value, str):
                table[key] = Path(path).parent / value
        return cls(**table)  # type: ignore[arg-type]  # the class checks kinds

    def _content(self, name: str) -> bytes:
        file = getattr(self, name)
        try:
            return Path(file).read_bytes()
        except OSError as error:
            raise InvalidSetting(f"about: {name} {file} cannot be read: {error.strerror or error}") from None

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of a model description."""
        author = ", ".join(filter(None, (self.author, self.company)))
        found = {"version": self.version or metadata.version("servocore"), "author": author,
                 "copyright": self.copyright, "license": self.license}  # fmt: skip
        return {name: text for name, text in found.items() if text} | {"generationDateAndTime": DATE}

    @property
    def notice(self) -> str:
        """A comment for the first line of C sources."""
        text = " ".join(f"{self.copyright}. Licence: {self.license}. Written by {tool()}.".split())
        return f"/* {text.replace('*/', '* /').lstrip('. ')} */\n"

    def files(self, fmi: int) -> dict[str, bytes]:
        """Return the files of an FMU that replace or accompany ours.

        Parameters
        ----------
        fmi : int
            Version of FMI.

        Returns
        -------
        dict of str to bytes
            By their path in the FMU.

        Raises
        ------
        InvalidSetting
            If FMI 2 is to have an SVG drawing.
        """
        if fmi == 2 and Path(self.icon or "").suffix.lower() == ".svg":
            raise InvalidSetting("about: FMI 2 has PNG icons only")
        found = {}
        for name, (_, place) in _FILES.items():
            if (file := getattr(self, name)) is not None:
                where = "model{}" if fmi == 2 and name == "icon" else place
                found[where.format(Path(file).suffix.lower())] = self._content(name)
        return found
