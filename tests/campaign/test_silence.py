"""Runs that do not answer."""

from __future__ import annotations

import pytest

from tma_ray.campaign.failures import LOG_SECONDS, Silence


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_runs_that_do_not_answer_are_logged_once_a_minute_and_lost_after_their_time(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = Clock()
    silence = Silence(most_seconds=300.0, clock=clock)
    for _ in range(600):
        assert not silence.lasts("first")
        assert not silence.lasts("second")
        clock.now += 0.5
    assert len(caplog.records) == 300 / LOG_SECONDS
    assert "first, second do not answer" in caplog.messages[-1]
    silence.end("second")
    clock.now += 0.5
    assert silence.lasts("first")
    assert not silence.lasts("second"), "its time began anew"
