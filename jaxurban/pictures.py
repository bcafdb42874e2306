"""What every picture takes: its width, the axes that it fills, its title, and of a map the colours."""

from typing import Any, TypedDict


class Form(TypedDict, total=False):
    """How a picture stands on a page.

    Attributes:
      width: ``"column"`` or ``"page"`` of a journal (88.9 or 182 mm), or millimetres; left out, a page.
      ax: a cell of another Matplotlib figure (``plt.subplots``), in place of which the picture stands; what is returned
        is that part of the figure. A cell below 5.5 inches holds a map without its legend and its note:
        what is guessed and whom to credit (`jaxurban.cite`) is then for a caption. ``ax`` itself is gone, so that a
        title is given by ``title``.
      title: in place of the picture's own; empty for none.
    """

    width: str | float
    ax: Any
    title: str | None


class MapForm(Form, total=False):
    """How a picture of maps stands on a page, and in which colours.

    Attributes:
      cmap: a colour map of Matplotlib or its name, of all maps that have a scale.
    """

    cmap: Any
