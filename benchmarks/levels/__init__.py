"""What the models of a scene cost and how exact they are: measured, and the page docs/model-levels.md."""
