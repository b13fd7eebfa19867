"""A job with large results, in its own file: a worker imports it without the tests."""

from dataclasses import dataclass

from graycast.cell.engine.job import Job, TaskResult


@dataclass(frozen=True, slots=True, kw_only=True)
class HeavyJob(Job):
    """A job whose results are larger than a pipe, so that they are read while they are written."""

    def open(self, **_ignored):
        return self

    def make(self, scene_id):
        return TaskResult(
            scene_id=scene_id,
            files=(("large.bin", bytes(16_000_000)),),
            seconds=0.0,
            reasons={},
            rss_bytes=0,
        )

    def close(self):
        pass
