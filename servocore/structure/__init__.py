"""What the equations of a system say before they are solved: signature, derivative array, projection, zero dynamics."""
