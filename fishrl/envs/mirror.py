"""Mirror images about the horizontal axis of a flow: x stays, y changes its sign."""

from collections.abc import Sequence
from typing import NamedTuple

from fishrl.envs.sense import Sense


class Mirror(NamedTuple):
    """How observation and action of a mirrored fish follow from those of the fish.

    Entries of an observation are signed numbers from 1: number i of the mirrored one is number
    ``abs(entry i)`` of the other, with the sign of the entry.
    """

    observation: tuple[int, ...]  #: of one observation
    critic_observation: tuple[int, ...]  #: of what only critics read
    #: mirror image of each discrete action, or the sign of each number of a continuous one
    action: tuple[int, ...]

    def check(self, *, num_obs: int, num_actions: int, is_discrete: bool) -> "Mirror":
        """Return itself, if it fits a task.

        Raises:
            ValueError: if numbers or actions have no mirror image, or one that is not mirrored back
                into them.
        """
        if len(self.observation) != num_obs:
            raise ValueError(
                f"reflect: the mirror image of {len(self.observation)} of {num_obs} numbers is "
                "known; list senses with Sense(mirror=...) instead of observe, or reflect=false"
            )
        for image in (self.observation, self.critic_observation):
            back = [image[abs(entry) - 1] * (1 if entry > 0 else -1) for entry in image]
            if back != [*range(1, len(image) + 1)]:
                raise ValueError(
                    f"reflect: Sense(mirror=...) gives {image}, whose own image must be the "
                    "observation: 2 for 1 needs 1 for 2, and -2 for 1 needs -1 for 2"
                )
        action, numbers = self.action, range(num_actions)
        fits = (
            sorted(action) == [*numbers] and all(action[action[a]] == a for a in numbers)
            if is_discrete
            else len(action) == num_actions and {*action} <= {-1, 1}
        )
        if not fits:
            wanted = (
                f"the image of each of 0 to {num_actions - 1}, whose own image is the action"
                if is_discrete
                else f"{num_actions} signs, 1 or -1"
            )
            raise ValueError(f"reflect: mirrored_actions = {action}: must be {wanted}")
        return self


def join_mirrors(senses: Sequence[Sense]) -> tuple[int, ...]:
    """Return the mirror image of the numbers of senses one after the other.

    Raises:
        ValueError: if a sense has none.
    """
    joined: list[int] = []
    for sense in senses:
        if sense.mirror is None:
            raise ValueError(
                f"reflect: the sense {sense.name!r} has no mirror image; give Sense(mirror=...), "
                "or do not observe it"
            )
        if sorted(map(abs, sense.mirror)) != list(range(1, 1 + len(sense.numbers))):
            raise ValueError(
                f"mirror = {sense.mirror} of the sense {sense.name!r}: must name each of 1 to "
                f"{len(sense.numbers)} once, with a sign"
            )
        start = len(joined)
        joined += [entry + start if entry > 0 else entry - start for entry in sense.mirror]
    return tuple(joined)
