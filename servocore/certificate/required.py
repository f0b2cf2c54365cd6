"""Inputs that must be proved: a certificate that is refuted is an error."""

from __future__ import annotations

import warnings

from servocore.certificate.certify import Certificate, certify
from servocore.certificate.statements import LIMIT
from servocore.errors import InvalidReference, LimitBroken, ServocoreWarning
from servocore.model.scene import Scene
from servocore.solution import Solution


def require_certified(
    subject: Scene | Solution,
    tolerance: float = 1e-8,
    *,
    model: str | None = None,
    warn: bool = True,
) -> Certificate:
    """Return the certificate of a scene or a solution unless it is refuted; warn where it is undecided.

    Raises
    ------
    LimitBroken
        If a limit is refuted.
    InvalidReference
        If another statement is.

    Warns
    -----
    ServocoreWarning
        If the certificate is undecided and `warn` is set.
    """
    certificate = certify(subject, tolerance=tolerance, model=model)
    text = f"{certificate.name}: the certificate is {certificate.summary}"
    if certificate.verdict == "refuted":
        broken = next(each for each in certificate.statements if each.verdict == "refuted")
        raise (LimitBroken if broken.what.startswith(LIMIT) else InvalidReference)(text)
    if warn and certificate.verdict == "undecided":
        warnings.warn(text, ServocoreWarning, stacklevel=3)
    return certificate
