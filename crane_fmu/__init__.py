"""The rotary crane as FMUs, a command line and a report, on public names of servocore only."""
