"""Divide scenes into train, validation and test sets."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count

from ...base.errors import GraycastError
from ...base.public_value import public_value
from ...base.settings import check_fields

NAMES = ("train", "val", "test")
_STEP = 0x9E3779B97F4A7C15  # 2^64 divided by the golden ratio, an odd number
_TURN = 2**64


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """Fractions of the scenes that go to train, val and test.

    The set of a scene depends only on the seed and the scene's id, so it is the same in every
    format and when the dataset grows. Multiples of the golden ratio modulo 1, shifted by the seed,
    are spread evenly: among up to 5000 consecutive scenes, each set has its share to within four.
    The choice need not be random, because the scenes of a dataset are independent.

    Source: Knuth, "The Art of Computer Programming", vol. 3, section 6.4 (Fibonacci hashing).
    """

    shares: tuple[float, float, float] = (1.0, 0.0, 0.0)
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if min(self.shares) < 0 or abs(sum(self.shares) - 1) > 1e-6:
            raise GraycastError(
                f"split is {self.shares}: give shares of train, val and test that are at least 0 "
                "and add up to 1, such as 0.8,0.1,0.1"
            )

    def place(self, scene_id: int) -> str:
        """Return the set that a scene belongs to."""
        start = int.from_bytes(hashlib.sha256(f"split {self.seed}".encode()).digest()[:8])
        at = (start + scene_id * _STEP) % _TURN / _TURN
        train, val, _ = self.shares
        last = NAMES[max(i for i, share in enumerate(self.shares) if share > 0)]
        return "train" if at < train else "val" if at < train + val else last

    def least(self) -> int:
        """Return the least number of scenes, from id 0, for which no set with a share is empty."""
        wanted = {name for name, share in zip(NAMES, self.shares, strict=True) if share > 0}
        for scene_id in count():
            wanted.discard(self.place(scene_id))
            if not wanted:
                break
        return scene_id + 1

    def assign(self, image_ids: Iterable[int], *, images: int = 1) -> dict[str, list[int]]:
        """Return the pictures of each set with a share, in order; a scene's pictures stay together.

        Args:
            image_ids: numbers of pictures; each scene has `images` of them.

        Raises:
            GraycastError: a set with a share gets no scene.
        """
        sets: dict[str, list[int]] = {
            name: [] for name, share in zip(NAMES, self.shares, strict=True) if share > 0
        }
        for image_id in sorted(image_ids):
            sets[self.place(image_id // images)].append(image_id)
        for name, ids in sets.items():
            if not ids:
                scenes = sum(map(len, sets.values())) // images
                raise GraycastError(
                    f"split: {name} gets none of the {scenes} scenes: the first {self.least()} "
                    "scenes of a dataset have some for each set; make so many, or give larger "
                    "shares or another seed"
                )
        return sets


def parse_shares(text: str) -> tuple[float, float, float]:
    """Read shares such as '0.8,0.1,0.1'; omitted shares are 0.

    Raises:
        GraycastError: the text is not one to three numbers.
    """
    try:
        shares = [float(word) for word in text.split(",")]
    except ValueError:
        shares = []
    if not 1 <= len(shares) <= 3:
        raise GraycastError(f"shares are {text!r}: give one to three, such as 0.8,0.1,0.1")
    train, val, test = shares + [0.0] * (3 - len(shares))
    return train, val, test
