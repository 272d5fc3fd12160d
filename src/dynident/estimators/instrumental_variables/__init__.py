"""Instrumental variables: consistent although the noise of the positions is in the regressor."""

from dynident.estimators.instrumental_variables.fit import InstrumentalVariables

__all__ = ["InstrumentalVariables"]
