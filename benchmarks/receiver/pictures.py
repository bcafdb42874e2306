"""Pictures of displaced cities beside the city in its place."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from benchmarks.receiver.evidence import Evidence
from jaxurban.draw.style import INK, chart, dress, letter_all, styled
from jaxurban.receivers.figures import ROOFS
from jaxurban.receivers.report import HIDDEN, SEEN

NAMES = {"auc": "all satellites", "within": "within each satellite"}  # of scores


@styled
def plot_displacement(evidence: Evidence) -> Figure:
    """Return how well the city fits the receiver where it is moved or its roofs are scaled: three panels of AUC.

    The city moved by metres, as a map of moves; moved by 80 to 450 m, as histograms; and by the factor of all heights.
    """
    note = (
        "AUC: of two satellites of which the maps hide one, how often the one in view is the stronger.\n"
        "Cross and line: best fit; circle and band: 95 % of the best fits of resampled tracks."
    )
    figure = chart(2.7, "Would another place, city or height fit the receiver as well?", note)
    field, cities, scales = axes = figure.subplots(1, 3, width_ratios=(1.0, 1.5, 0.8))
    for panel in axes:
        dress(panel)

    # Moved by metres: a map of the AUC by the move, with the best move and the circle around it.
    auc = evidence.field.pivot(index="north_m", columns="east_m", values="auc")
    image = field.pcolormesh(auc.columns, auc.index, auc, cmap="cividis")
    figure.colorbar(image, ax=field, label="AUC", shrink=0.75, anchor=(0, 1), panchor="N")
    field.plot(evidence.peak["east_m"], evidence.peak["north_m"], "x", color=INK)
    field.add_patch(Circle((0, 0), evidence.peak["within_95_m"], fill=False))
    field.grid(visible=False)
    field.set(
        xlabel="city moved east (m)",
        ylabel="city moved north (m)",
        aspect="equal",
        title="moved by metres",
    )

    # Moved by hundreds of metres, and roofs scaled.
    draw_cities(cities, evidence, {"within": HIDDEN, "auc": SEEN})
    scales.axvspan(evidence.peak["scale_low"], evidence.peak["scale_high"], color=ROOFS, alpha=0.5)
    scales.axvline(evidence.peak["scale"], color=INK)
    scales.plot(evidence.scales.scale, evidence.scales.auc, color=SEEN)
    scales.set(xlabel="factor of roof heights", ylabel="AUC", title="roofs scaled")
    letter_all(axes)
    return figure


def draw_cities(panel: Axes, evidence: Evidence, colours: Mapping[str, str]) -> None:
    """Draw how displaced cities score, as histograms, and the city in its place, as lines.

    Args:
      panel: to draw in.
      evidence: with the scores.
      colours: of the scores that are drawn, by their columns (`NAMES`).
    """
    (in_place,) = evidence.of.scores[evidence.of.scores.which == "all"].to_dict("records")
    for name, colour in colours.items():
        label = f"displaced, {NAMES[name]}"
        panel.hist(evidence.displaced[name].dropna(), bins=15, color=colour, alpha=0.6, label=label)
        label = f"the city in its place: {in_place[name]:.2f}"
        panel.axvline(in_place[name], color=colour, label=label)
    room = 1 + 0.3 * len(colours)  # above the bars, for the legend
    panel.set_ylim(top=panel.get_ylim()[1] * room)
    panel.legend(loc="upper left")
    title = f"{evidence.displaced.auc.notna().sum()} cities, moved by 80 to 450 m"
    panel.set(xlabel="AUC (0.5 by chance, 1 at best)", ylabel="displaced cities", title=title)
