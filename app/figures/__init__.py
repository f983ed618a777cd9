"""Figure builders: data in, plotly figure out. They know no Dash, no callback and no file."""

from app.figures.anytime import anytime_figure
from app.figures.bands import bands_figure
from app.figures.comparing import comparing_figure
from app.figures.energy import energy_figure
from app.figures.occupancy import occupancy_figure
from app.figures.power import power_figure
from app.figures.reservations import reservations_figure
from app.figures.soc import soc_figure
from app.figures.throughput import throughput_figure

__all__ = [
    "anytime_figure",
    "bands_figure",
    "comparing_figure",
    "energy_figure",
    "occupancy_figure",
    "power_figure",
    "reservations_figure",
    "soc_figure",
    "throughput_figure",
]
