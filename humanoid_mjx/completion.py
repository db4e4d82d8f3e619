"""What completes a name on the command line. Where nothing does, shells complete paths by themselves."""


def configs(incomplete: str) -> list[str]:
    """Configs that ship and whose names begin so."""
    return _names("configs", ".yaml", incomplete)


def policies(incomplete: str) -> list[str]:
    """Policies that ship and whose names begin so."""
    return _names("policies", ".npz", incomplete)


def _names(kind: str, ending: str, incomplete: str) -> list[str]:
    from humanoid_mjx.data import names  # whose imports take time that all other commands save

    return [name for name in names(kind, ending) if name.startswith(incomplete)]
