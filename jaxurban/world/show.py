"""How things show themselves: one line of text, and one table in a notebook."""

from collections.abc import Mapping
from html import escape


class Shown:
    """Base of what tells its `facts`; those that are empty are left out."""

    @property
    def facts(self) -> Mapping[str, str]:
        """What it is, fact by name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(f'{name}: {fact}' for name, fact in self.facts.items() if fact)})"

    def _repr_html_(self) -> str:
        rows = (f"<tr><th>{escape(name)}</th><td>{escape(fact)}</td></tr>" for name, fact in self.facts.items() if fact)
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"


def listed(values: list[str] | tuple[str, ...], most: int = 6) -> str:
    """Return values with commas; of many the first and the last ones, and how many there are."""
    if len(values) <= most:
        return ", ".join(values)
    return f"{', '.join(values[: most - 1])} ... {values[-1]} ({len(values)})"
