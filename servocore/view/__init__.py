"""Live pages: a solution in HTML that computes again in the browser while one drags."""
