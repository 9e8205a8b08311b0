"""neuroflight results: the page of results from stored figures."""

from __future__ import annotations

import argparse
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--folder",
        type=Path,
        default=DOCS / "results",
        metavar="DIR",
        help="what evaluate, fly and stability printed with --json; default: docs/results",
    )
    parser.add_argument(
        "--out", type=Path, default=DOCS / "results.md", metavar="FILE.md", help="default: docs/results.md"
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; fail if the page is not up to date"
    )


def run(args: argparse.Namespace) -> int:
    """Write the page, or compare it with what would be written."""
    from toolchain.cli.output import check_output
    from toolchain.errors import NeuroflightError
    from toolchain.files import write_text_if_changed
    from training.results import render
    from training.stored import read_results

    check_output(args.out, ".md")
    results = read_results(args.folder)
    page = render(results)
    if args.check:
        if not args.out.is_file() or args.out.read_bytes() != page.encode():
            raise NeuroflightError(
                f"{args.out}: not what the files in {args.folder} give; run `neuroflight results`"
            )
        print(f"{args.out}: up to date with {len(results)} files")
        return 0
    written = write_text_if_changed(args.out, page)
    print(f"{args.out}: {'written from' if written else 'already up to date with'} {len(results)} files")
    return 0
