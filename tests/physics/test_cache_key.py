"""Keys of files that are kept on disk."""

from pathlib import Path

import pytest

from fishrl.physics.cache_key import hash_sources, make_key, read_code

CODE = '''"""A module."""


def double(x):
    """Return twice x."""
    return 2 * x  # exact
'''


@pytest.mark.parametrize(
    ("old", "new", "counts"),
    [
        ("2 * x", "3 * x", True),
        ("# exact", "# a comment", False),
        ("twice x", "the double of x", False),
        ("\n\n\ndef", "\ndef", False),
    ],
)
def test_code_counts_but_not_comments(old: str, new: str, counts: bool, tmp_path: Path) -> None:
    file, other = tmp_path / "a.py", tmp_path / "b.py"
    file.write_text(CODE)
    other.write_text(CODE.replace(old, new))
    assert CODE.replace(old, new) != CODE
    assert (read_code(file) != read_code(other)) is counts


def test_key_depends_on_parts_and_named_packages() -> None:
    assert make_key(1, "a") == make_key(1, "a") != make_key(1, "b")
    assert hash_sources() != hash_sources("fishrl.envs")


def test_kept_hash_follows_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = []
    for old, new in (("", ""), ("# exact", "# a comment"), ("2 * x", "3 * x"), ("", "")):
        (tmp_path / "doubling.py").write_text(CODE.replace(old, new))
        hash_sources.cache_clear()
        found.append(hash_sources("doubling"))
    assert found[0] == found[1] == found[3] != found[2]
    assert len(list((tmp_path / "cache/fishrl/sources").iterdir())) == 3
