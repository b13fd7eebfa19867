"""A progress meter that records what it receives."""


class Metered:
    """Progress meter whose `counts` are tuples (kind, done, total)."""

    def __init__(self):
        self.stages, self.counts, self.notes = [], [], []

    def stage(self, text):
        self.stages.append(text)

    def count(self, what, done, total):
        self.counts.append((what, done, total))

    def note(self, text):
        self.notes.append(text)
