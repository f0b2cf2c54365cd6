"""The command ``crane-fmu``."""

from servocore.cli.interruption import run_command_line


def main() -> None:
    """Run the command line; the entry point of the package."""
    run_command_line("crane-fmu", "crane_fmu.cli.commands")
