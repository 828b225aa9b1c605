"""The frame of a page for people: one file that a browser or a letter shows as it is, light or dark."""

import html
from collections.abc import Iterable

_STYLE = """
:root { color-scheme: light dark; --ink: #1d2126; --soft: #5c6570; --line: #d9dde2; --page: #fff; --card: #f5f6f8;
  --link: #0b62c4 }
@media (prefers-color-scheme: dark) { :root { --ink: #e7e9ec; --soft: #9aa4b0; --line: #343a42; --page: #15181c;
  --card: #1e2228; --link: #7db8ff } }
* { box-sizing: border-box }
body { margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 78rem; background: var(--page); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif }
h1 { margin: 0 0 .6rem; font-size: 1.8rem; line-height: 1.2 }
h2 { margin: 2.4rem 0 .6rem; font-size: 1.2rem }
a { color: var(--link) }
.soft { color: var(--soft) }
.wide { overflow-x: auto }
table { border-collapse: collapse }
th, td { border-bottom: 1px solid var(--line); text-align: left; vertical-align: top }
th { color: var(--soft); font-size: .85rem; font-weight: 600 }
code { padding: .1em .3em; border-radius: .3rem; background: var(--card); font-size: .9em; overflow-wrap: anywhere }
""".strip()


def html_page(title: str, parts: Iterable[str], style: str = "") -> str:
    """A whole page.

    Parameters
    ----------
    parts : of the body, as HTML.
    style : CSS after the common one, whose colours it may use: --ink, --soft, --line, --page, --card, --link.
    """
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escaped(title)}</title>\n<style>\n{_STYLE}\n{style.strip()}\n</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def escaped(text: str) -> str:
    """Text as it stands in HTML, also within an attribute."""
    return html.escape(text, quote=True)
