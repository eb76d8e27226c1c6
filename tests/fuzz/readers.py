"""Every kind of file that HESR reads: a valid one, and its reader."""

from logs_and_robots import LOGS_AND_ROBOTS
from results import RESULTS
from settings import SETTINGS

READERS = {**LOGS_AND_ROBOTS, **SETTINGS, **RESULTS}
