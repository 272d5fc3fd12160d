"""A configuration drafted from a robot file and the columns of recordings."""
