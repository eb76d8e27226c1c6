"""Every kind of file that HESR reads: a valid one, and its reader."""

from logs_and_robots import LOGS_AND_ROBOTS
from result_files import RESULTS
from settings import SETTINGS

READERS = {**LOGS_AND_ROBOTS, **SETTINGS, **RESULTS}
