"""The drive of a move that is learned: what is asked of the model is no longer what is desired."""

from __future__ import annotations

from dataclasses import dataclass, field

from dbo_cli.drives.compensation import Compensation
from dbo_cli.extras.repeat.learning import Lesson, write_history
from dbo_cli.extras.repeat.options import RepeatOptions
from dbo_cli.logs.sample_block import FloatArray


@dataclass
class LearnedCompensation(Compensation):
    """A run over what recordings of the last pass have taught to ask for.

    Attributes
    ----------
    lesson : Lesson, optional
        What they have taught; the source then holds what is asked of the model instead
        of the trajectory.
    """

    options: RepeatOptions = field(default_factory=RepeatOptions)
    lesson: Lesson | None = None

    def __post_init__(self) -> None:
        """Take the options apart."""
        super().__post_init__()
        if self.lesson is not None:
            self.states_error = False
            self.remarks_before.add(self.lesson.remarks)

    def desired_rows(self, rows: FloatArray) -> FloatArray:
        """Return the trajectory's rows instead of what was asked of the model."""
        if self.lesson is None:
            return rows
        end = self.rows - self.rows_before
        return self.lesson.desired[end - rows.size : end]

    def finish(self) -> None:
        """Write the history, where one is asked for."""
        if self.options.history is not None and self.lesson is not None:
            write_history(self.options.history, self.lesson.passes)
