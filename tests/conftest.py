"""Settings of all tests."""

from hypothesis import Phase, settings

settings.register_profile("patient", deadline=None)  # a busy machine is no error
settings.register_profile("mutation", deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))
settings.load_profile("patient")
