"""The command ``servocore``, and what the command lines of this project share."""
