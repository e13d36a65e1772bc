"""Curves, statistics, claims, figures and pages, as functions of tidy frames.

These names are loaded on first use, because their modules need pandas, SciPy or matplotlib.
"""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.analysis.compare.claims import claims_table
    from miho.analysis.compare.leaderboard import leaderboard, results_table
    from miho.analysis.curves import on_grid, summary
    from miho.analysis.figures.design import design_figure
    from miho.analysis.figures.engine import fig5
    from miho.analysis.figures.house import save
    from miho.analysis.figures.paper import fig4, fig6, plot_error_over, plot_tires
    from miho.analysis.pages.run import save_report
    from miho.analysis.pages.sweep import save_sweep_page
    from miho.analysis.text import to_markdown

__all__ = [
    "claims_table", "design_figure", "fig4", "fig5", "fig6", "leaderboard", "on_grid",
    "plot_error_over", "plot_tires", "results_table", "save", "save_report", "save_sweep_page",
    "summary", "to_markdown",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(
    __name__,
    {
        "write_csv": "use `miho.load_runs(root).runs.to_csv(file, index=False)`",
        "write_ioh": "IOHanalyzer reads the table `curves` of `load_runs` as a custom CSV file",
        "write_parquet": "use `DataFrame.to_parquet`, with the package pyarrow",
    },
)
