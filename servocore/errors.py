"""What can go wrong, as sentences: every error of the library derives from `ServocoreError`.

An error names the culprit, the limit it broke and, where there is one, the time. Command lines print the
sentence and exit with code 2; nothing else is caught.
"""

from __future__ import annotations


class ServocoreError(Exception):
    """Base of all errors that a user can cause or meet."""


class ServocoreWarning(UserWarning):
    """Something that will not do, or has not done, what its user expects: said in advance, or after a look at it."""


class InvalidModel(ServocoreError):
    """A mechanical system contradicts itself: sizes, symmetry, rank, parameter bounds, unknown names."""


class InvalidReference(ServocoreError):
    """A load path cannot be followed or read: not finite, too rough, slack rope, load above the girder."""


class InvalidSetting(ServocoreError):
    """A numerical setting makes no sense: a step that is not positive or does not divide the duration."""


class InconsistentStart(ServocoreError):
    """No positions, velocities, multipliers and inputs satisfy the equations at the initial time."""


class IntegrationFailed(ServocoreError):
    """A time step was not solved; the sentence names time, step, the worst equation and likely causes."""
