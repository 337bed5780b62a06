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
