"""Compiled functions and what belongs to them as text. This module travels with `servocore.stepping.program`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar

import casadi as ca

from servocore.errors import ServocoreError

Saved = TypeVar("Saved")


def to_json(value: Any, form: str) -> str:
    """Serialize a dataclass of functions, numbers, texts and tuples of them or of small dataclasses.

    Parameters
    ----------
    value : dataclass
        Its functions go in CasADi's own format, together: what they share is saved once.
    form : str
        Name and version of the format.
    """
    functions = ca.StringSerializer()
    document: dict[str, object] = {"format": form, "casadi": ca.__version__}
    known: dict[str, object] = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
    functions.pack([entry for entry in known.values() if isinstance(entry, ca.Function)])
    document["functions"] = functions.encode()
    for name, content in known.items():
        if isinstance(content, tuple):
            document[name] = [asdict(item) if is_dataclass(item) else item for item in content]  # type: ignore[arg-type]  # no class
        elif not isinstance(content, ca.Function):
            document[name] = content
    return json.dumps(document)


def from_json(kind: type[Saved], text: str, form: str, parts: Mapping[str, type]) -> Saved:
    """Undo `to_json`.

    Parameters
    ----------
    kind : type
        The dataclass that was saved.
    text : str
        What `to_json` made.
    form : str
        As it was saved.
    parts : mapping of str to type
        The dataclasses within its tuples, by field.

    Raises
    ------
    ServocoreError
        If the text is nothing of the kind.
    """
    what = f"the saved {kind.__name__.lower()}"
    try:
        document = json.loads(text)
        if document.pop("format") != form:
            raise ServocoreError(f"{what} has another format")
        document.pop("casadi")  # for humans
        functions = iter(ca.StringDeserializer(document.pop("functions")).unpack())
        for name in (field.name for field in fields(kind) if field.init):  # type: ignore[arg-type]  # a dataclass
            if name not in document:
                document[name] = next(functions)
            elif isinstance(document[name], list):
                made = parts.get(name)
                document[name] = tuple(made(**item) if made else item for item in document[name])
        return kind(**document)
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError, StopIteration) as error:
        raise ServocoreError(f"{what} cannot be read: {error}") from error
