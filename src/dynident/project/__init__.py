"""A configuration and what follows from it: the model, the recipe, the recordings, the saved result."""
