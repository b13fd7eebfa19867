"""A progress meter that remembers what it hears."""


class Metered:
    """Progress meter whose `counts` are (kind, done, total)."""

    def __init__(self):
        self.stages, self.counts, self.notes = [], [], []

    def stage(self, text):
        self.stages.append(text)

    def count(self, what, done, total):
        self.counts.append((what, done, total))

    def note(self, text):
        self.notes.append(text)
