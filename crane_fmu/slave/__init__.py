"""The slave that travels into the FMUs, and the words that FMUs and pages have in common."""
