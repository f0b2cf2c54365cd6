"""Parameters of a scene from logs of its drives, with their standard errors, and paths that show them."""
