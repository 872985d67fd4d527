"""What the page is made of: titled sections, charts, and pairs of sections side by side, as HTML."""

from __future__ import annotations

from html import escape

import plotly.graph_objects as go

from ground_station.report.splat import Pixels, data_uri


def section(title: str, lead: str, content: str) -> str:
    """A titled box with a sentence that explains it."""
    return f"<section><h2>{escape(title)}</h2>{f'<p class=soft>{escape(lead)}</p>' if lead else ''}{content}</section>"


def chart_section(title: str, lead: str, figure: go.Figure | None, below: str = "") -> str:
    """A section with a chart; nothing when there is none."""
    return section(title, lead, chart(figure) + below) if figure is not None else ""


def pair(*sections: str) -> str:
    """Two sections side by side; one alone takes the whole width."""
    shown = [s for s in sections if s]
    return f"<div class=two>{''.join(shown)}</div>" if len(shown) == 2 else "".join(shown)


def chart(figure: go.Figure) -> str:
    """An interactive chart; the page loads plotly itself."""
    options = {"displaylogo": False, "displayModeBar": False, "responsive": True}
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=options))


def row(pictures: list[tuple[str, Pixels]], kind: str = "PNG") -> str:
    """Pictures with their captions, three side by side."""
    return f"<div class=three>{''.join(figure(name, picture, kind) for name, picture in pictures)}</div>"


def figure(caption: str, picture: Pixels, kind: str = "PNG") -> str:
    """A picture with its caption."""
    return (f"<figure><img src='{data_uri(picture, kind)}' alt='{escape(caption, quote=True)}'>"
            f"<figcaption>{escape(caption)}</figcaption></figure>")
