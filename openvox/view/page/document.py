"""HTML from Python, with every text escaped unless it was made here, and the frame around a page.

A page asks nobody for anything: its policy allows its own scripts and styles, by their digests, and pictures that are
part of the file. What stands in a caption cannot run even if it were written into the page as it is.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any

_VOID = frozenset({"img", "input", "meta", "br"})


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def escaped(text: str) -> Html:
    """Any text as HTML; control characters and marks that turn the direction of reading are shown as `?`."""
    shown = "".join(letter if letter.isprintable() or letter in "\n\t" else "?" for letter in text)
    return Html(html.escape(shown))


def tag(name: str, /, *children: Any, **attributes: Any) -> Html:
    """An element. children: texts, which are escaped, Html, numbers, or sequences of these; None is left out.

    attributes: `class_` and `for_` lose their underscore, `data_x` is `data-x`; True stands alone, None and False
    are left out.
    """
    pairs = []
    for key, value in attributes.items():
        label = key.rstrip("_").replace("_", "-")
        if value is True:
            pairs.append(f" {label}")
        elif value is not None and value is not False:
            pairs.append(f' {label}="{escaped(str(value))}"')
    start = f"<{name}{''.join(pairs)}>"
    return Html(start if name in _VOID else f"{start}{joined(children)}</{name}>")


def joined(children: Iterable[Any]) -> Html:
    """Children one after another, each as `tag` takes them."""
    parts: list[str] = []
    for child in children:
        if isinstance(child, Html):
            parts.append(child)
        elif isinstance(child, (str, int, float)):
            parts.append(escaped(str(child)))
        elif child is not None:
            parts.append(joined(child))
    return Html("".join(parts))


def data_uri(kind: str, data: bytes) -> str:
    """A file as an address: kind is its media type, as image/jpeg."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def page(title: str, body: Iterable[Any], data: Mapping[str, Any]) -> str:
    """A whole page. data: what its scripts read, as JSON."""
    folder = files("openvox.view.page")
    style = (folder / "page.css").read_text("utf-8")
    script = (folder / "scene.js").read_text("utf-8") + (folder / "page.js").read_text("utf-8")
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; script-src {_digest(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    content = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", title),
        Html(f"<style>{style}</style>"),
    )
    scripts = Html(f'<script type="application/json" id="data">{content}</script><script>{script}</script>')
    return f"<!doctype html>\n{tag('html', head, tag('body', body, scripts), lang='en')}\n"


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
