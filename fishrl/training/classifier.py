"""The classifier of a run: read from a file, kept in the run folder."""

import filecmp
from pathlib import Path
from shutil import copyfile

from fishrl.envs.transforms import ORACLE
from fishrl.files import staged
from fishrl.modules import LateralLineClassifier
from fishrl.training.policy_zoo import PREFIX, find_policy

#: Name of the classifier that a run has copied into its folder.
OWN = "machine.pt"

Recognition = LateralLineClassifier | str | None


def load_recognition(choice: Recognition, folder: Path = Path()) -> Recognition:
    """Return the source of flow labels, for ``make_env(recognition=...)``.

    ``choice`` is None, ``oracle``, a classifier, the file of one, or ``zoo/<name>`` for that of a
    policy; ``folder`` is the run or checkpoint where a run's own classifier is looked for.
    """
    if not isinstance(choice, str) or choice == ORACLE:
        return choice
    return LateralLineClassifier.load(Path(str(find_classifier(choice, folder))).expanduser())


def find_classifier(choice: Recognition, folder: Path) -> Recognition:
    """Return the setting of a run with a classifier as a path, wherever the run lies now."""
    if isinstance(choice, str) and choice.startswith(PREFIX):
        return str(find_policy(choice) / OWN)
    if choice != OWN:
        return choice
    places = [place / OWN for place in (folder, *folder.resolve().parents[:2])]
    return str(next((path for path in places if path.is_file()), places[0]))


def keep_recognition(choice: Recognition, folder: Path) -> str | None:
    """Copy the classifier of a run into its folder, and return the setting of the run.

    Raises:
        ValueError: for a file that is no classifier.
    """
    if choice is None or choice == ORACLE:
        return choice
    if isinstance(choice, LateralLineClassifier):
        choice.save(folder / OWN)
        return OWN
    source = Path(str(find_classifier(choice, Path()))).expanduser()
    LateralLineClassifier.load(source)
    with staged(folder / OWN) as stage:
        copyfile(source, stage)
    return OWN


def name_recognition(choice: Recognition, folder: Path) -> str | None:
    """Return a source of flow labels as the run in ``folder`` names it, if it has the same."""
    own = folder / OWN
    if choice is None:
        return None
    if isinstance(choice, str):
        file = Path(str(find_classifier(choice, folder))).expanduser()
        is_same = own.is_file() and file.is_file() and filecmp.cmp(own, file, shallow=False)
        return OWN if is_same else str(file) if file.is_file() else choice
    if own.is_file():
        kept, given = LateralLineClassifier.load(own).state_dict(), choice.state_dict()
        if kept.keys() == given.keys() and all(kept[n].equal(given[n].cpu()) for n in kept):
            return OWN
    return "another classifier"
