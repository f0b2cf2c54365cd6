"""A C compiler that keeps the libraries it has built by their content: the tests build the same ones again and again.

`conftest.py` puts it, named `cc`, before the compiler of the machine. Whatever builds no library goes to that
compiler as it is. The file imports little, as it is run for every library.
"""

import hashlib
import os
import subprocess
import sys

KEPT = "SERVOCORE_TEST_LIBRARIES"
"""Environment variable with the folder of libraries."""
OPTIONS = "SERVOCORE_TEST_OPTIONS"
"""Environment variable with what the compiler of libraries is told besides."""


def script(compiler: str) -> str:
    """Return a shell script that stands in for a compiler."""
    return f'#!/bin/sh\nexec "{sys.executable}" -S -E "{os.path.abspath(__file__)}" "{compiler}" "$@"\n'


def key_of(compiler: str, arguments: list[str], output: str) -> str:
    """Return a hash of all that a library depends on: compiler, options, sources and headers, whatever the folder."""
    about = os.stat(compiler)
    found = hashlib.sha256(repr((compiler, about.st_size, about.st_mtime_ns)).encode())
    here = os.getcwd()
    for place in [here, *headers(arguments)]:
        for name in sorted(os.listdir(place)):
            if name != output:
                add(found, os.path.join(place, name), name)
    for each in arguments:
        add(found, each, each.replace(here, "."))
    return found.hexdigest()


def headers(arguments: list[str]) -> list[str]:
    """Return the folders in which the compiler looks for headers."""
    attached = [each[2:] for each in arguments if each.startswith("-I")]
    separate = [arguments[k + 1] for k in range(len(arguments) - 1) if arguments[k] in {"-I", "-isystem"}]
    return [each for each in attached + separate if os.path.isdir(each)]


def add(found: "hashlib._Hash", path: str, name: str) -> None:
    """Add a name, and the content of the file if it is one's."""
    found.update(name.encode() + b"\0")
    if os.path.isfile(path):
        with open(path, "rb") as file:
            found.update(file.read() + b"\0")


def main() -> int:
    """Compile, or copy what was compiled before."""
    compiler, *arguments = sys.argv[1:]
    folder = os.environ.get(KEPT)
    if not folder or "-shared" not in arguments or "-o" not in arguments:
        os.execv(compiler, [compiler, *arguments])
    arguments += os.environ.get(OPTIONS, "").split()
    output = arguments[arguments.index("-o") + 1]
    kept = os.path.join(folder, key_of(compiler, arguments, output))
    if not os.path.exists(kept):
        status = subprocess.run([compiler, *arguments], check=False).returncode
        if status:
            return status
        beside = f"{kept}.{os.getpid()}"
        copy(output, beside)
        os.replace(beside, kept)  # whole or not at all, whoever else builds it
    copy(kept, output)
    return 0


def copy(source: str, target: str) -> None:
    """Copy a file, with the right to execute it."""
    with open(source, "rb") as file, open(target, "wb") as made:
        made.write(file.read())
    os.chmod(target, 0o755)


if __name__ == "__main__":
    sys.exit(main())
