"""Run the benchmarks named by number, all of them by default."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

from tests.benchmarks import detection, extraction, filters, growth, iteration, path

BENCHMARKS = dict(enumerate((iteration, path, detection, extraction, filters, growth), start=1))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("number", nargs="*", type=int, help="1 to 6; all by default")
    parser.add_argument("--quick", action="store_true", help="tiny clouds, to see that everything runs")
    options = parser.parse_args()
    if not set(options.number) <= set(BENCHMARKS):
        parser.error(f"numbers are {min(BENCHMARKS)} to {max(BENCHMARKS)}")
    if len(options.number) == 1:
        report(options.number[0], options.quick)
        return
    for number in options.number or BENCHMARKS:  # each in its own process: what one leaves in memory slows the next
        words = [str(number), *(["--quick"] if options.quick else [])]
        subprocess.run([sys.executable, "-m", "tests.benchmarks", *words], check=True)


def report(number: int, quick: bool) -> None:
    """Run one benchmark and print its ratios as they come."""
    benchmark = BENCHMARKS[number]
    print(f"\n{number}. {(benchmark.__doc__ or '').splitlines()[0]}")
    print(f"   load of this machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
    for result in benchmark.measure(quick):
        print(f"   {result}", flush=True)


if __name__ == "__main__":
    main()
