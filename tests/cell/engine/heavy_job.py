"""A job with large results, in a file of its own: a worker imports what it needs and no tests."""

from dataclasses import dataclass

from graycast.cell.engine.job import Job, TaskResult


@dataclass(frozen=True, slots=True, kw_only=True)
class HeavyJob(Job):
    """Its results are larger than what a pipe holds, so they are read while they are written."""

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
