"""A C compiler that keeps libraries and objects by their content: the tests build the same ones again and again.

`conftest.py` puts it, named `cc`, before the compiler of the machine. Whatever builds something else goes to that
compiler as it is, and what it has something to say about is not kept. The file imports little, as it is run for each.
"""

import hashlib
import os
import subprocess
import sys

KEPT = "SERVOCORE_TEST_LIBRARIES"
"""Environment variable with the folder of libraries."""
OPTIONS = "SERVOCORE_TEST_OPTIONS"
"""Environment variable with what the compiler of libraries is told besides."""
MADE = (".o", ".su")
"""Ends of the names of objects and of the sizes of their stack frames."""


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
            if name != output and not name.endswith(MADE):  # by compilers beside; objects to link are arguments
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
    if not folder or not {"-shared", "-c"} & {*arguments} or "-o" not in arguments:
        os.execv(compiler, [compiler, *arguments])
    arguments += os.environ.get(OPTIONS, "").split()
    output = arguments[arguments.index("-o") + 1]
    kept = os.path.join(folder, key_of(compiler, arguments, output))
    frames = [os.path.splitext(output)[0] + ".su"] if "-fstack-usage" in arguments else []
    made = {**dict.fromkeys(frames, f"{kept}.su"), output: kept}  # the output last: where it is, all is
    if not os.path.exists(kept):
        run = subprocess.run([compiler, *arguments], stderr=subprocess.PIPE, check=False)
        sys.stderr.buffer.write(run.stderr)
        if run.returncode or run.stderr or not all(map(os.path.exists, made)):
            return run.returncode
        for source, target in made.items():
            beside = f"{target}.{os.getpid()}"
            copy(source, beside)
            os.replace(beside, target)  # whole or not at all, whoever else builds it
    for target, source in made.items():
        copy(source, target)
    return 0


def copy(source: str, target: str) -> None:
    """Copy a file, with the right to execute it."""
    with open(source, "rb") as file, open(target, "wb") as made:
        made.write(file.read())
    os.chmod(target, 0o755)


if __name__ == "__main__":
    sys.exit(main())
