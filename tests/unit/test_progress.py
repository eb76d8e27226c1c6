from collections.abc import Iterator

from hesr_model.support.progress import counted, unheard


def test_items_are_counted_before_each_and_after_the_last() -> None:
    told: list[object] = []

    def work() -> Iterator[str]:
        for item in counted("ab", lambda done, total: told.append((done, total))):
            told.append(item)
            yield item

    assert list(work()) == ["a", "b"]
    assert told == [(0, 2), "a", (1, 2), "b", (2, 2)]


def test_nobody_hears_what_is_told_to_nobody() -> None:
    assert list(counted([1, 2, 3], unheard)) == [1, 2, 3]
