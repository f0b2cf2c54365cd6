"""Valid names in C and FMI: identifiers from a scene's name, and distinct names of variables."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence

from servocore.errors import InvalidModel
from servocore.export.variables import Variable, listed
from servocore.problem import Problem

_LONGEST_IDENTIFIER = 40
_NAMES_TAKEN = ("main", "all", "clean", "help", "install", "package", "test")  # files, and CMake's own targets


def identifier_of(name: str) -> str:
    """Return a name as an identifier of C, at most 40 characters long."""
    # CasADi does not accept two consecutive underscores.
    identifier = re.sub(r"[\W_]+", "_", name, flags=re.ASCII)[:_LONGEST_IDENTIFIER].strip("_")
    if not identifier:
        return "model"
    taken = not identifier[0].isalpha() or keyword.iskeyword(identifier) or identifier.lower() in _NAMES_TAKEN
    return f"model_{identifier}" if taken else identifier


def require_different(problem: Problem, variables: Sequence[Variable], taken: Sequence[str]) -> None:
    """Raise `InvalidModel` if two variables have one name, or a name is not valid in FMI."""
    names = [each.name for each in listed(variables, 2)]
    every = [*names, *taken]
    repeated = sorted({name for name in every if every.count(name) > 1})
    if repeated:
        raise InvalidModel(f"{problem.name} cannot be exported: variables named twice: {', '.join(repeated)}")
    broken = [name for name in names if not re.fullmatch(r"[a-zA-Z_]\w*(\.\w+)*(\[\d+\])?", name, flags=re.ASCII)]
    if broken:
        raise InvalidModel(
            f"{problem.name} cannot be exported: FMI has no variable called {broken[0]!r}; names are the letters a to z"
            f" and A to Z, digits and underscores"
        )
