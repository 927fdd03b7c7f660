"""Select the trials of a study that must run, and run them on Dask."""

from collections import Counter
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial

from fingerflow.errors import FingerflowError
from fingerflow.study.cache_keys import all_codes, trial_keys
from fingerflow.study.cluster import Interrupted, run_on_workers, threads_each, workers_for
from fingerflow.study.manifest import Manifest, TrialEntry
from fingerflow.study.trial import is_current, run_trial
from fingerflow.study.trial_files import FAILED, MEASURED, Part, TrialRow, has_result, read_row, write_row

# Trial that must run: its entry in the manifest, what to redo ("everything", only what has "changed", or only the table
# "row"), and why.
Planned = tuple[TrialEntry, Part, str]


@dataclass
class Summary:
    """Outcome of a study run: numbers of trials selected to run and of those left as they were, the outcomes of
    those that ran by name, and the reason if the run was interrupted.
    """

    planned: int
    skipped: int
    outcomes: dict[str, TrialRow] = field(default_factory=dict)
    interrupted: str = ""

    def __str__(self) -> str:
        """Return a text with one line of counts, and one line for each failed trial."""
        counts = Counter(outcome.status for outcome in self.outcomes.values())
        left = self.planned - len(self.outcomes)
        rest = f", {left} not run" if left else ""
        lines = [f"{counts[MEASURED]} trials measured, {counts[FAILED]} failed, {self.skipped} were done already{rest}"]
        for name, outcome in self.outcomes.items():
            if outcome.status == FAILED:
                again = " (is tried again by the next run)" if outcome.passing else ""
                lines.append(f"  {name}: {outcome.reason}{again}")
        return "\n".join(lines + ([f"stopped: {self.interrupted}"] if self.interrupted else []))


def plan_run(manifest: Manifest, only: str | None = None, retry_failed: bool = False) -> list[Planned]:
    """Return the trials that lack a result for their current inputs, settings and code, in manifest order.

    Args:
        manifest: the study.
        only: a pattern of names of trials such as "03_*"; the others are left as they are.
        retry_failed: include failed trials of which nothing has changed.

    Raises FingerflowError if `only` matches no trial.
    """
    entries = [entry for entry in manifest.trials if only is None or fnmatchcase(entry.name, only)]
    if not entries:
        names = ", ".join(entry.name for entry in manifest.trials[:3])
        raise FingerflowError(f"--only {only}: no trial has such a name; they are {names} ...")
    plans = (_plan_trial(manifest, entry, retry_failed) for entry in entries)
    return [planned for planned in plans if planned is not None]


def run_study(
    manifest: Manifest,
    scheduler: str | None = None,
    workers: int | None = None,
    only: str | None = None,
    retry_failed: bool = False,
    progress: bool = True,
) -> Summary:
    """Run the trials selected by `plan_run`, in processes on this computer or on a cluster.

    Each task is one trial. Finished trials are stored in the results folder: Ctrl-C or the loss
    of a worker or of the scheduler ends the run without losing them.

    Args:
        manifest: the study.
        scheduler: the address of a Dask scheduler, or the name of a deployment class, such as
            "dask_jobqueue.SLURMCluster", which takes its settings from Dask's own configuration. None for a cluster
            of processes on this computer.
        workers: processes; by default one per core. Remaining cores become threads of each.
        only, retry_failed: as in `plan_run`.
        progress: show a bar.

    Raises FingerflowError if the cluster is not available.
    """
    planned = plan_run(manifest, only, retry_failed)
    chosen = [entry for entry in manifest.trials if only is None or fnmatchcase(entry.name, only)]
    summary = Summary(len(planned), len(chosen) - len(planned))
    if not planned:
        return summary
    threads = threads_each(scheduler, workers_for(len(planned), workers))
    run = partial(run_trial, codes=all_codes(), threads=threads)
    tasks = ((entry.name, (replace(manifest, trials=(entry,)), redo)) for entry, redo, _ in planned)
    failed = partial(_outcome_of_error, manifest)
    try:
        for name, outcome in run_on_workers(run, tasks, len(planned), failed, scheduler, workers, progress):
            summary.outcomes[name] = outcome
    except Interrupted as stop:
        summary.interrupted = str(stop)
    return summary


def _plan_trial(manifest: Manifest, entry: TrialEntry, retry_failed: bool) -> Planned | None:
    folder = manifest.results / entry.name
    stored = read_row(folder)
    if stored is None:
        return entry, "everything", "has not been run" if not folder.exists() else "has no row"
    if stored.status == FAILED and (stored.passing or retry_failed):
        return entry, "everything", f"failed: {stored.reason}"
    try:
        keys = trial_keys(manifest.build_scene(entry), None if stored.keys is None else stored.keys.inputs)
    except FingerflowError as error:
        # The trial would fail with the same message again, so its row is final.
        return None if stored.reason == str(error) else (entry, "everything", f"cannot be run: {error}")
    if stored.keys is None:
        return entry, "everything", "could not be opened last time"
    if is_current(stored, keys, folder):
        return None
    changed = stored.keys.changed_inputs(keys)
    if changed:
        return entry, "everything", f"{', '.join(changed)} changed"
    if stored.status == FAILED:
        return entry, "everything", "settings or code changed since it failed"
    if not has_result(folder, stored):
        return entry, "everything", "its result is gone or damaged"
    if stored.keys.result != keys.result:
        return entry, "changed", "settings or code changed; what does not depend on them is kept"
    return entry, "row", "the table has other columns now; the result is kept"


def _outcome_of_error(manifest: Manifest, name: str, error: BaseException) -> tuple[str, TrialRow]:
    """Return the name and the outcome "failed" of the trial `name`, whose worker was killed or which raised `error`; if
    `error` is a FingerflowError, raise it again.
    """
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        reason = (
            "every worker that took it was killed, as where memory is too small: give fewer workers, or ask why in "
            "their logs"
        )
        outcome = TrialRow(FAILED, reason, passing=True)
        write_row(manifest.results / name, outcome)
        return name, outcome
    if isinstance(error, FingerflowError):
        raise error
    return name, TrialRow(FAILED, f"unexpected {type(error).__name__}: {error}", passing=True)
