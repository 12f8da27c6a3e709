"""Errors in the browser make a test fail."""

import pytest
from browser import opened, outside_resources


@pytest.mark.parametrize(
    "body", ['<script>console.error("x")</script>', "<script>nothing()</script>", '<img src="missing.png">']
)
def test_page_errors_fail_the_test(body, tmp_path):
    with pytest.raises(AssertionError):
        opened(f'<body data-ready="yes">{body}</body>', tmp_path)


def test_external_resources_are_found():
    page = '<img src="data:image/png;base64,AA"><a href="other.html"><script src="a.js"></script><style>b{c:url(d.png)}'
    assert outside_resources(page + '<link rel="stylesheet" href="e.css">') == ["a.js", "d.png", "e.css"]
