"""The browser's errors do not go unseen."""

import pytest
from browser import opened, outside_resources


@pytest.mark.parametrize(
    "body", ['<script>console.error("x")</script>', "<script>nothing()</script>", '<img src="missing.png">']
)
def test_errors_of_a_page_are_errors_of_the_test(body, tmp_path):
    with pytest.raises(AssertionError):
        opened(f'<body data-ready="yes">{body}</body>', tmp_path)


def test_resources_from_elsewhere_are_found():
    page = '<img src="data:image/png;base64,AA"><a href="other.html"><script src="a.js"></script><style>b{c:url(d.png)}'
    assert outside_resources(page + '<link rel="stylesheet" href="e.css">') == ["a.js", "d.png", "e.css"]
