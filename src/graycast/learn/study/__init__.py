"""Studies: runs over models x inputs x training sets x test sets x seeds, and one table."""

from ..study_file import StudySpec, read_study
from .study_runs import Result, StudyRun, run_study, runs_of
from .study_tables import write_study

__all__ = ["Result", "StudyRun", "StudySpec", "read_study", "run_study", "runs_of", "write_study"]
