"""Settings of the whole suite: no example may fail by the clock, and every run tries the same examples."""

from hypothesis import settings

settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")
