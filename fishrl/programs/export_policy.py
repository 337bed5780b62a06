"""Export a learned policy: ``fishrl export-policy run=runs/<name> folder=<folder>``.

Writes its weights, settings, learning curve, final evaluation and model card, without what only its
training needs; every program takes the folder as ``policy=<folder>``. ``upload=<user>/<name>``
also uploads it to the Hugging Face Hub, which needs the extra ``hub`` and a login
(``hf auth login``, or ``HF_TOKEN``).
"""

import subprocess
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fishrl.extras import show_install
from fishrl.programs.program import program
from fishrl.training.export import export_policy


def read_revision() -> str | None:
    """Return the commit of this code; None where it is no git checkout, or has been changed."""
    git = ["git", "-C", str(Path(__file__).parents[1])]

    def ask(*words: str) -> str:
        return subprocess.run([*git, *words], check=False, capture_output=True, text=True).stdout

    try:
        is_ours = ask("ls-files", "__init__.py")  # not installed into somebody's checkout
        is_changed = ask("status", "--porcelain", ".", ":!benchmark/scores")
        return ask("rev-parse", "HEAD").strip() if is_ours and not is_changed else None
    except FileNotFoundError:  # git
        return None


def send(folder: Path, repository: str) -> str:
    """Upload a folder to a repository of the Hugging Face Hub; return the address of the commit.

    Raises:
        OSError: if the hub cannot be reached or refuses.
    """
    from huggingface_hub import HfApi
    from huggingface_hub.errors import HTTPError

    api = HfApi()
    try:
        api.create_repo(repository, exist_ok=True)
        return str(api.upload_folder(repo_id=repository, folder_path=folder))
    except HTTPError as error:
        raise OSError(f"upload = {repository}: {' '.join(str(error).split())}") from error


@program(export_policy, without=("revision",))
def main(*, upload: str | None = None, **given: Any) -> None:
    """Export the policy of a run, and upload it if asked.

    Args:
        upload: repository of the Hugging Face Hub to upload the folder to, ``<user>/<name>``; it is
            created, for everyone to read, if it does not exist.
        **given: arguments of ``export_policy``.
    """
    if upload is not None and find_spec("huggingface_hub") is None:
        raise ImportError(f"upload needs a package: {show_install('hub')}")
    folder = export_policy(**given, revision=read_revision())
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    print(f"written to {folder}: {size / 1e6:.2f} MB")
    if upload is not None:
        print(f"uploaded to {send(folder, upload)}")
