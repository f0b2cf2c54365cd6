"""Routes from a problem to its solution, and forward dynamics to try one: one file each."""
