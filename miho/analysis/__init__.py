"""Curves, statistics, claims and figures: functions of the tidy frames of runs and curves."""

from miho.analysis.claims import claims_table
from miho.analysis.engine_figures import fig5
from miho.analysis.figures import fig4, fig6, plot_error_over, plot_tires, save
from miho.analysis.ioh import write_ioh
from miho.analysis.leaderboard import leaderboard
from miho.analysis.markdown import to_markdown
from miho.analysis.results import results_table

__all__ = [
    "claims_table", "fig4", "fig5", "fig6", "leaderboard", "plot_error_over", "plot_tires",
    "results_table", "save", "to_markdown", "write_ioh",
]  # fmt: skip
