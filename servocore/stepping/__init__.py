"""One step as a compiled program: initial values, steps, observation; and the plant that moves under inputs."""
