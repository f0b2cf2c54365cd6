"""Libraries of machine code that outlive a process: a folder of its user's own, from which nothing unknown is loaded.

Every file is named after what was compiled and how, and after its own contents: a file that is damaged or half written
has another hash than its name says. Files are written beside their place and renamed into it, so that any number of
processes may build the same.
"""

from __future__ import annotations

import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

FOLDER = "SERVOCORE_CACHE"
"""Environment variable with the folder, if not the user's own for caches."""

MOST_BYTES = 64 * 1024**2
"""Of all libraries: beyond, the ones that were not used longest are removed."""

_SUFFIX = ".so"


@dataclass(frozen=True)
class CodeCache:
    """A folder of compiled libraries.

    Attributes
    ----------
    folder : Path
        Made when something is stored, for its user alone.
    """

    folder: Path

    @classmethod
    def of_user(cls) -> CodeCache:
        """Return that of the environment variable `FOLDER`, or else the one in the user's folder for caches."""
        import platformdirs  # noqa: PLC0415 - it takes a tenth of the time that importing the library takes

        named = os.environ.get(FOLDER)
        return cls(Path(named) if named else platformdirs.user_cache_path("servocore") / "machine-code")

    def refusal(self) -> str:
        """Say why nothing is loaded from this folder or stored there; empty if it is as it should be, or not there."""
        try:
            status = self.folder.lstat()
        except FileNotFoundError:
            return ""
        except OSError as error:
            return f"{self.folder} cannot be looked at: {error.strerror}"
        if not stat.S_ISDIR(status.st_mode):
            return f"{self.folder} is no folder"
        if hasattr(os, "getuid"):
            if status.st_uid != os.getuid():
                return f"{self.folder} belongs to another user"
            if stat.S_IMODE(status.st_mode) != 0o700:
                mode = stat.S_IMODE(status.st_mode)
                return f"{self.folder} has mode {mode:04o}: it must be its user's alone, mode 0700"
        return ""

    def find(self, key: str) -> Path | None:
        """Return the library of a key; one whose contents are not those that were stored is removed instead."""
        if self.refusal():
            return None
        for path in self._libraries(f"{key}-*"):
            try:
                known = _hash(path.read_bytes())
                if path.stem == f"{key}-{known}":
                    os.utime(path)
                    return path
                path.unlink()
            except OSError:
                continue  # another process has removed it
        return None

    def store(self, key: str, contents: bytes) -> Path | None:
        """Store a library and return its path; None if the folder cannot be used."""
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if self.refusal():
                return None
            self._trim(len(contents))
            path = self.folder / f"{key}-{_hash(contents)}{_SUFFIX}"
            beside = self.folder / f"{os.urandom(8).hex()}.part"
            try:
                beside.write_bytes(contents)
                beside.replace(path)
            finally:
                beside.unlink(missing_ok=True)
        except OSError:
            return None
        return path

    def contents(self) -> list[Path]:
        """Return all libraries."""
        return sorted(self._libraries("*"))

    def clear(self) -> tuple[int, int]:
        """Remove all that was stored; return how many libraries and how many bytes these were."""
        count = size = 0
        if self.refusal():
            return 0, 0
        for path in self._libraries("*"):
            length = path.stat().st_size
            path.unlink(missing_ok=True)
            count, size = count + 1, size + length
        for left in self.folder.glob("*.part"):
            left.unlink(missing_ok=True)
        return count, size

    def _libraries(self, pattern: str) -> list[Path]:
        """Return files, and no links to files, in no order."""
        libraries = self.folder.glob(f"{pattern}{_SUFFIX}") if self.folder.is_dir() else ()
        return [path for path in libraries if path.is_file() and not path.is_symlink()]

    def _trim(self, more: int) -> None:
        """Remove what was not used longest until `more` bytes have room."""
        known = sorted(((path.stat(), path) for path in self._libraries("*")), key=lambda entry: entry[0].st_mtime)
        size = sum(status.st_size for status, _ in known) + more
        for status, path in known:
            if size <= MOST_BYTES:
                return
            path.unlink(missing_ok=True)
            size -= status.st_size


def _hash(contents: bytes) -> str:
    return hashlib.sha256(contents).hexdigest()[:32]
