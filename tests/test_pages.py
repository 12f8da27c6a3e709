"""Following a page succeeds if its results are as stated, and fails otherwise."""

import pytest
from pages import blocks, follow, marked

PAGE = """# A page

<!-- write notes/a.txt -->
```yaml
one two
```

Not marked, not run:

```
exit 1
```

<!-- run -->
```
cat notes/a.txt
echo three four five > b.txt; cat b.txt
```

<!-- prints -->
```
one   two
three ... five
```

<!-- makes -->
```
notes/a.txt
b.txt
```
"""


@pytest.fixture
def page(tmp_path):
    """Write a page and follow it in a new folder."""

    def written(text):
        (tmp_path / "page.md").write_text(text)
        follow(tmp_path / "page.md", tmp_path)

    return written


def test_correct_page(page, tmp_path):
    page(PAGE)
    assert [block.kind for block in blocks(tmp_path / "page.md")] == ["write", "run", "prints", "makes"]
    assert (tmp_path / "notes" / "a.txt").read_text() == "one two\n"


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("cat notes/a.txt", "cat notes/c.txt", "No such file"),
        ("cat notes/a.txt", "false | cat", "false | cat"),
        ("three ... five", "three ... six", "is not in, or not at its place"),
        ("one   two\nthree ... five", "three ... five\none two", "is not in, or not at its place"),
        ("notes/a.txt\nb.txt", "notes/a.txt\nc.txt", "c.txt is not there"),
        ("echo three four five > b.txt; cat b.txt", "echo three four five; touch b.txt", "b.txt is not there"),
        ("<!-- run -->\n", "<!-- run -->\nand then\n", "4 comments, 3 blocks"),
    ],
)
def test_wrong_page_fails(page, right, wrong, message):
    assert right in PAGE
    with pytest.raises(AssertionError, match=message.replace("|", r"\|")):
        page(PAGE.replace(right, wrong))


def test_example_data_at_the_end_are_made_first(page):
    stand_in = "\n<!-- run first -->\n```\necho seven > given.txt; echo eight\n```\n"
    page("<!-- run -->\n```\ncat given.txt\n```\n\n<!-- prints -->\n```\nseven\n```\n" + stand_in)
    # Their output belongs to no earlier block.
    with pytest.raises(AssertionError, match="nothing has been run"):
        page("<!-- prints -->\n```\neight\n```\n" + stand_in)


def test_cluster_blocks_run_only_with_a_cluster(tmp_path):
    text = PAGE.replace(
        "<!-- makes -->", "<!-- run on slurm -->\n```\necho six > c.txt\n```\n\n<!-- makes on slurm -->"
    )
    (tmp_path / "page.md").write_text(text.replace("notes/a.txt\nb.txt\n", "c.txt\n"))
    follow(tmp_path / "page.md", tmp_path)
    assert not (tmp_path / "c.txt").exists()
    follow(tmp_path / "page.md", tmp_path, slurm=True)
    assert (tmp_path / "c.txt").read_text() == "six\n"
    (tmp_path / "page.md").write_text(text.replace("notes/a.txt\nb.txt\n", "d.txt\n"))
    with pytest.raises(AssertionError, match="d.txt is not there"):
        follow(tmp_path / "page.md", tmp_path, slurm=True)


def test_pages_with_marked_blocks_are_found_in_every_folder(tmp_path):
    for name, text in (("a/one.md", PAGE), ("two.md", PAGE), ("a/three.md", "# A page\n\n```\nls\n```\n")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert [page.name for page in marked(tmp_path)] == ["one.md", "two.md"]
