"""What an arm carries: the ten inertial parameters of a payload, from recordings with and without it."""
