"""The slave that travels into the FMUs."""
