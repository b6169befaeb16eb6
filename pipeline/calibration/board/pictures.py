"""Coverage of a camera's picture by the corners of a board, as an SVG document."""

import numpy as np

from pipeline.calibration.board.views import BoardViews

_CELLS = (8, 6)
_WIDTH = 480
_MAX_DOTS = 4000


def covered_share(views: BoardViews) -> float:
    """Share of the cells of the picture, 8 x 6, in which a corner was seen."""
    return float((_counts(views) > 0).mean())


def coverage_svg(views: BoardViews) -> str:
    """Draw the corners that were seen; cells without any are red."""
    width, height = views.size_px
    scale = _WIDTH / width
    counts = _counts(views)
    across, down = _WIDTH / _CELLS[0], height * scale / _CELLS[1]
    cells = "".join(
        f'<rect x="{column * across:.1f}" y="{row * down:.1f}" width="{across:.1f}" height="{down:.1f}"/>'
        for row, column in np.argwhere(counts == 0)
    )
    corners = views.corners_px.reshape(-1, 2)
    corners = corners[np.isfinite(corners).all(-1)] * scale
    corners = corners[:: max(1, len(corners) // _MAX_DOTS)]
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5"/>' for x, y in corners)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height * scale:.0f}" role="img">'
        f"<title>Corners of the board in {len(views)} views</title>"
        f'<rect width="100%" height="100%" fill="#f4f4f4"/>'
        f'<g fill="#d62728" fill-opacity="0.25">{cells}</g><g fill="#1f4e79">{dots}</g></svg>\n'
    )


def _counts(views: BoardViews) -> np.ndarray:
    corners = views.corners_px.reshape(-1, 2)
    corners = corners[np.isfinite(corners).all(-1)]
    width, height = views.size_px
    counts, _, _ = np.histogram2d(
        corners[:, 1], corners[:, 0], bins=_CELLS[::-1], range=[[-0.5, height - 0.5], [-0.5, width - 0.5]]
    )
    return counts
