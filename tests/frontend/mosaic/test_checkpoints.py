"""Jobs whose results are known keep their places and are not done again."""

from __future__ import annotations

from typing import Any

from frontend.mosaic.checkpoints import NO_MOSAIC_CHECKPOINTS, with_checkpoints


class Dictionary:
    def __init__(self, known: dict[object, Any]) -> None:
        self.known = known

    def recall(self, item: object) -> Any:
        return self.known.get(item)

    def keep(self, item: object, result: object) -> None:
        self.known[item] = result


def done(shared: list[int], item: int) -> int | None:
    shared.append(item)
    return None if item == 5 else item * item


def test_known_jobs_are_not_done_again():
    checkpoints, worked, earlier = Dictionary({2: "kept"}), [], {7: "reused"}
    found = list(with_checkpoints(checkpoints, done, worked, [1, 2, 3, 5, 7], None, earlier.get))
    assert found == [1, "kept", 9, None, "reused"]
    assert sorted(worked) == [1, 3, 5]
    assert checkpoints.known == {1: 1, 2: "kept", 3: 9}


def test_without_checkpoints_all_jobs_are_done():
    worked: list[int] = []
    assert list(with_checkpoints(NO_MOSAIC_CHECKPOINTS.stage("any", None), done, worked, [1, 2])) == [1, 4]
    assert sorted(worked) == [1, 2]
