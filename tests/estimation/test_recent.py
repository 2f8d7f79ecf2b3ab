"""Results that are kept for whoever asks again."""

from __future__ import annotations

from yieldmon.estimation.recent import Recent


def test_what_was_asked_for_last_is_not_made_again() -> None:
    made: list[str] = []
    kept: Recent[str] = Recent(2)

    def of(key: str) -> str:
        return kept.of(key, lambda: made.append(key) or key.upper())

    assert [of(key) for key in ("a", "b", "a", "c", "a", "b")] == ["A", "B", "A", "C", "A", "B"]
    assert made == ["a", "b", "c", "b"], "of three the one that was not asked for longest is made again"
