# SPDX-License-Identifier: Apache-2.0
"""HTML elements with escaped content."""

from collections.abc import Iterable, Sequence
from html import escape

Cell = str | tuple[str, str]  # text, or text and the class of its cell


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def tag(name: str, *children: str | None, **attributes: str | bool | None) -> Markup:
    """Return an element; children are escaped unless they are `Markup`, None is left out.

    An attribute that is a word of Python ends in `_`, one with hyphens has `_` in their place; True has no value.
    """
    written = "".join(
        f" {_attribute(key)}" + ("" if value is True else f'="{escape(str(value))}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    return Markup(f"<{name}{written}>{joined(children)}</{name}>")


def void(name: str, **attributes: str | bool | None) -> Markup:
    """Return an element that has no content, such as an image."""
    return Markup(tag(name, **attributes).removesuffix(f"</{name}>"))


def joined(children: Iterable[str | None]) -> Markup:
    """Return the children one after another, escaped unless they are `Markup`."""
    return Markup("".join(child if isinstance(child, Markup) else escape(child) for child in children if child))


def table(titles: Sequence[str], rows: Iterable[Sequence[Cell]], *, caption: str) -> Markup:
    """Return a table that scrolls by itself where it is too wide, and is sorted by a click on a title."""
    heads = [tag("th", title, scope="col") for title in titles]
    body = [tag("tr", *(_cell(cell) for cell in row)) for row in rows]
    return tag(
        "div",
        tag(
            "table",
            tag("caption", caption),
            tag("thead", tag("tr", *heads)),
            tag("tbody", *body),
            data_sortable=True,
        ),
        class_="scroll",
        tabindex="0",
        role="region",
        aria_label=caption,
    )


def section(key: str, title: str, *children: str | None, text: str = "", short: str | None = None) -> Markup:
    """Return a section of the page with its heading and a sentence on what it shows; the contents have a short name."""
    about = tag("p", text, class_="about") if text else None
    return tag("section", tag("h2", title), about, *children, id=key, data_short=short)


def _attribute(key: str) -> str:
    return key.rstrip("_").replace("_", "-")


def _cell(cell: Cell) -> Markup:
    text, kind = (cell, "") if isinstance(cell, str) else cell
    return tag("td", text, class_=kind or ("number" if _is_number(text) else None))


def _is_number(text: str) -> bool:
    try:
        float(text.rstrip("%"))
    except ValueError:
        return text in ("–", "")
    return True
