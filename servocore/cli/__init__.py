"""The command ``servocore``, and modules shared by the command lines of this project."""

from servocore.cli.interruption import run_command_line


def main() -> None:
    """Run the command line; the entry point of the package."""
    run_command_line("servocore", "servocore.cli.commands")
