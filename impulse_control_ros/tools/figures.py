"""The style of figures for print and docs, and their files: the same figure, the same bytes."""

from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from impulse_control_ros.files.atomic_write import replaced

STYLE: dict[Any, Any] = {  # Any: the names that matplotlib allows vary
    'font.size': 9.0,
    'axes.titlesize': 9.0,
    'legend.fontsize': 8.0,
    'axes.grid': True,
    'grid.alpha': 0.3,
    'lines.linewidth': 1.4,
    'legend.framealpha': 0.9,
    'pdf.fonttype': 42,
    'axes.formatter.useoffset': False,
}
WIDTH = 9.0  # in
PRINT_DPI, DOCS_DPI = 200, 120
# without dates and versions the same figure gives the same bytes
METADATA: dict[str, dict[str, Any]] = {'png': {'Software': None}, 'pdf': {'CreationDate': None}}


def saved(figure: Figure, suffix: str, dpi: int) -> bytes:
    """Return a figure as the content of a file."""
    content = BytesIO()
    figure.savefig(content, format=suffix, dpi=dpi, metadata=METADATA[suffix])
    return content.getvalue()


def save(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure as a PNG or PDF file, by the ending of ``path``."""
    with replaced(path) as made:
        made.write_bytes(saved(figure, path.suffix[1:], dpi))
