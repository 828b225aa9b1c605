from mscf.html_page import escaped, html_page


def test_a_page_is_whole_and_its_own_style_comes_last() -> None:
    page = html_page("A & B", ["<h1>A</h1>", "<p>B</p>"], "h1 { color: var(--soft) }")
    assert page.startswith("<!doctype html>")
    assert page.endswith("</html>\n")
    assert "<title>A &amp; B</title>" in page
    assert "<h1>A</h1>\n<p>B</p>" in page
    assert page.index("h1 { margin") < page.index("h1 { color: var(--soft) }") < page.index("</style>")


def test_a_page_needs_nothing_from_elsewhere() -> None:
    assert "://" not in html_page("", ())


def test_text_is_no_markup_even_within_an_attribute() -> None:
    assert escaped("<b a=\"1\" c='2'>&") == "&lt;b a=&quot;1&quot; c=&#x27;2&#x27;&gt;&amp;"
