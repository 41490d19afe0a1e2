"""Where the rigs of a campaign are made and diagnosed: on this machine, or on a Dask cluster.

dask scheduler
PYTHONPATH=benchmarks dask worker tcp://HOST:8786 --nworkers 4 --nthreads 1
python benchmarks/campaign.py --kind dual --out DIR --scheduler tcp://HOST:8786
"""

from contextlib import nullcontext


def add_arguments(parser, jobs):
    """Give a benchmark's command --jobs and --scheduler."""
    parser.add_argument("--jobs", type=int, default=jobs, help="processes")
    parser.add_argument("--scheduler", help="address of a Dask scheduler to run on instead")


def where(scheduler):
    """Context in which joblib sends tasks to the scheduler's workers, or to own processes."""
    if scheduler is None:
        return nullcontext()
    from joblib import parallel_config

    return parallel_config(backend="dask", scheduler_host=scheduler)
