"""Checks beyond the residual of the equations: limits, angles, branches, errors of the inputs."""
