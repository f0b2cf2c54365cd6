"""Cache of compiled libraries on disk: a folder private to its user, from which only verified files are loaded.

The name of a file holds a hash of source and compiler options, and a hash of its contents, which reveals damaged and
incomplete files. Files are written under a temporary name and then renamed, so that processes may build the same
library at the same time.
"""

from __future__ import annotations

import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

FOLDER = "SERVOCORE_CACHE"
"""Environment variable with the folder; the default is the user's folder for caches."""

MOST_BYTES = 64 * 1024**2
"""Size of all libraries beyond which those not used for longest are removed."""

_SUFFIX = ".so"


@dataclass(frozen=True)
class CodeCache:
    """A folder of compiled libraries.

    Attributes
    ----------
    folder : Path
        Created by the first `store`, with mode 0700.
    """

    folder: Path

    @classmethod
    def of_user(cls) -> CodeCache:
        """Return the cache in the folder of the environment variable `FOLDER`, else in the user's folder for caches."""
        import platformdirs  # noqa: PLC0415 - it takes a tenth of the time that importing the library takes

        named = os.environ.get(FOLDER)
        return cls(Path(named) if named else platformdirs.user_cache_path("servocore") / "machine-code")

    def refusal(self) -> str:
        """Return why the folder is not used, as a sentence; empty if it can be used or does not exist."""
        try:
            status = self.folder.lstat()
        except FileNotFoundError:
            return ""
        except OSError as error:
            return f"{self.folder} cannot be examined: {error.strerror}"
        if not stat.S_ISDIR(status.st_mode):
            return f"{self.folder} is no folder"
        if hasattr(os, "getuid"):
            if status.st_uid != os.getuid():
                return f"{self.folder} belongs to another user"
            if stat.S_IMODE(status.st_mode) != 0o700:
                mode = stat.S_IMODE(status.st_mode)
                return f"{self.folder} has mode {mode:04o}: only its user may have access, mode 0700"
        return ""

    def find(self, key: str) -> Path | None:
        """Return the library of a key, None if there is none; a file with changed contents is removed."""
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
        """Remove all libraries; return their number and their size in bytes."""
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
        """Return the library files, without symbolic links, in no order."""
        libraries = self.folder.glob(f"{pattern}{_SUFFIX}") if self.folder.is_dir() else ()
        return [path for path in libraries if path.is_file() and not path.is_symlink()]

    def _trim(self, more: int) -> None:
        """Remove the libraries not used for longest, until `more` bytes can be added."""
        known = sorted(((path.stat(), path) for path in self._libraries("*")), key=lambda entry: entry[0].st_mtime)
        size = sum(status.st_size for status, _ in known) + more
        for status, path in known:
            if size <= MOST_BYTES:
                return
            path.unlink(missing_ok=True)
            size -= status.st_size


def _hash(contents: bytes) -> str:
    return hashlib.sha256(contents).hexdigest()[:32]
