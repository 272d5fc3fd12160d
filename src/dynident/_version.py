"""The version of dynident, and those of packages."""

__version__ = "0.1.0"


def package_version(name: str) -> str:
    """Return the version of a package, or that it is not installed as one."""
    from importlib import metadata  # slow to import

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:  # it may come from elsewhere
        return "not installed"
