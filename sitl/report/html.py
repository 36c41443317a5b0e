"""What every report is written in: one HTML file that needs no other. Text is escaped here, and nowhere else."""

from __future__ import annotations

import base64
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources

from sitl.report.cards import UNKNOWN, Card, State

_MARKS = {State.GOOD: ("✓", "met"), State.LOOK: ("!", "look here"), State.BAD: ("✕", "failed"), State.PLAIN: ("", "")}


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture and the sentence below it; ``half`` pictures stand beside their like."""

    png: bytes
    caption: str
    half: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and its pictures."""

    title: str
    pictures: Sequence[Picture]


def document(title: str, body: str) -> str:
    """A whole page around a body of HTML."""
    style = resources.files("sitl.report").joinpath("page.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""


def headline(title: str, state: State, sentence: str, facts: str, figures: Iterable[Card]) -> str:
    """What one sees first: what it is about, how it went in one sentence, and the key figures."""
    return f"""<h1>{escape(title)}</h1>
<p class="verdict {state}">{_mark(state)}{escape(sentence)}</p>
<p class="facts">{escape(facts)}</p>
<ul class="cards">
{"".join(_card(card) for card in figures)}</ul>
"""


def section(shown: Section) -> str:
    """A heading and its pictures, those of half the width side by side."""
    wide = "".join(_figure(picture) for picture in shown.pictures if not picture.half)
    half = "".join(_figure(picture) for picture in shown.pictures if picture.half)
    pair = f'<div class="pair">\n{half}</div>\n' if half else ""
    return f"<h2>{escape(shown.title)}</h2>\n{wide}{pair}"


def paragraph(text: str) -> str:
    """A paragraph of our own words."""
    return f"<p>{prose(text)}</p>\n"


def names_and_values(rows: Iterable[tuple[str, str]]) -> str:
    """A table of two columns."""
    lines = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>\n" for name, value in rows)
    return f"<table>\n{lines}</table>"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], code: Collection[int] = ()) -> str:
    """A table of many columns, which scrolls by itself where the window is narrower; those in ``code`` are typed."""
    head = "".join(f"<th>{prose(heading)}</th>" for heading in headings)
    lines = "".join(
        f"<tr>{''.join(_cell(cell, index in code) for index, cell in enumerate(row))}</tr>\n" for row in rows
    )
    return f'<div class="wide"><table>\n<tr>{head}</tr>\n{lines}</table></div>'


def links(files: Iterable[tuple[str, str]]) -> str:
    """Files beside the page, and what each is."""
    lines = "".join(f'<li><a href="{name}">{name}</a> <span>{what}</span></li>\n' for name, what in files)
    return f'<ul class="files">\n{lines}</ul>'


def folded(summary: str, text: str) -> str:
    """A long text that is seen when somebody asks for it."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def prose(text: str) -> str:
    """Our own words, with the symbols of the paper set as it sets them."""
    return re.sub(r"\b([dt])_([a-z])\b", r"<i>\1</i><sub>\2</sub>", escape(text))


def _cell(text: str, typed: bool) -> str:
    return f"<td><code>{escape(text)}</code></td>" if typed else f"<td>{prose(text)}</td>"


def _card(card: Card) -> str:
    kind = "value words" if card.words else "value"
    mark = "" if card.value == UNKNOWN else _mark(card.state)
    return (
        f'<li class="{card.state}"><span class="label">{prose(card.label)}</span>'
        f'<span class="{kind}">{mark}{escape(card.value)}</span>'
        f'<span class="note">{prose(card.note)}</span></li>\n'
    )


def _mark(state: State) -> str:
    sign, meaning = _MARKS[state]
    return f'<span class="mark" role="img" aria-label="{meaning}">{sign}</span> ' if sign else ""


def _figure(picture: Picture) -> str:
    source = f"data:image/png;base64,{base64.b64encode(picture.png).decode('ascii')}"
    return (
        f'<figure><div><img alt="{escape(picture.caption)}" src="{source}"></div>'
        f"<figcaption>{prose(picture.caption)}</figcaption></figure>\n"
    )
