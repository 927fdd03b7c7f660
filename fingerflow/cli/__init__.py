"""Command line of fingerflow: one function per command, one file per group of commands."""

import _thread
import signal
import sys
import threading

import typer

# Importing these modules adds their commands to the app.
from fingerflow.cli import bundles, preparation, processing, reporting, study, synthetic_recordings, tables, viewing  # noqa: F401
from fingerflow.cli.app import INTERRUPTED
from fingerflow.cli.app import app as app
from fingerflow.errors import FingerflowError


def main() -> None:
    """Run the command line; exit status 0 for success, 2 for an error that the user can correct, 130 if interrupted."""
    hook, sys.unraisablehook = sys.unraisablehook, _interrupt_again
    try:
        # Commands return nothing; typer returns the exit status, 130 where it caught the interrupt itself.
        code = app(standalone_mode=False) or 0
    except (FingerflowError, OSError) as error:
        typer.echo(f"fingerflow: {error}", err=True)
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        # Wrong usage: show typer's own message, which names the part of the command line.
        if hasattr(error, "show") and hasattr(error, "exit_code"):
            error.show()
            sys.exit(error.exit_code)
        raise
    finally:
        sys.unraisablehook = hook
    if code == INTERRUPTED:
        typer.echo("fingerflow: interrupted; nothing was left half-written", err=True)
    sys.exit(code)


def _interrupt_again(raised: "sys.UnraisableHookArgs") -> None:
    """Raise KeyboardInterrupt again in the main thread after Python discarded it in a callback."""
    if isinstance(raised.exc_value, KeyboardInterrupt):
        # Interrupt after this callback has returned, since an exception raised here would be lost. Only a signal to the
        # main thread wakes it while it waits, and Windows has no such signal.
        threading.Timer(0.01, _interrupt_the_main_thread).start()
    else:
        sys.__unraisablehook__(raised)


def _interrupt_the_main_thread() -> None:
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGINT)
    else:
        _thread.interrupt_main()
