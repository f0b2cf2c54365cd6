"""The command ``servocore`` where it is not on the path: ``python -m servocore``."""

from servocore.cli import main

main()
