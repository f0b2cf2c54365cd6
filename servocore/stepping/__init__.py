"""Programs: initial values, one step and observation as compiled functions; and the plant under given inputs."""
