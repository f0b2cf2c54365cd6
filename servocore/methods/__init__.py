"""Methods turn a `Dae` into the equations of one time step: one file each."""
