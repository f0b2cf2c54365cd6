"""Programs: initial values, one step and observation as compiled functions; forward dynamics of a plant."""
