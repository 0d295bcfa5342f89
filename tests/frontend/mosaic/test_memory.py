"""Jobs whose results are known keep their places and are not done again."""

from __future__ import annotations

from typing import Any

from frontend.mosaic.memory import NO_MOSAIC_MEMORY, remembered


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
    memory, worked, earlier = Dictionary({2: "kept"}), [], {7: "reused"}
    found = list(remembered(memory, done, worked, [1, 2, 3, 5, 7], None, earlier.get))
    assert found == [1, "kept", 9, None, "reused"]
    assert sorted(worked) == [1, 3, 5]
    assert memory.known == {1: 1, 2: "kept", 3: 9}


def test_without_a_memory_all_jobs_are_done():
    worked: list[int] = []
    assert list(remembered(NO_MOSAIC_MEMORY.stage("any", None), done, worked, [1, 2])) == [1, 4]
    assert sorted(worked) == [1, 2]
