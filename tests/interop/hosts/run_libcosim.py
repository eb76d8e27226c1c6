"""A system packaged as SSP, run by libcosim."""

import time

from files import case, leave
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

log_output_level(CosimLogLevel.WARNING)
given = case()
steps = given["steps"]
# Without a step size libcosim uses that of the SSP's annotation.
execution = CosimExecution.from_ssp_file(ssp_path=given["ssp"])
observer = CosimObserver.create_time_series(buffer_size=steps + 1)
execution.add_observer(observer=observer)
places = {}
for slave in execution.slave_infos():
    for variable in execution.slave_variables(slave.index):
        places[f"{slave.name.decode()}.{variable.name.decode()}"] = slave.index, variable.reference
for signal in given["signals"]:
    observer.start_time_series(*places[signal], CosimVariableType.REAL)
begin = time.perf_counter()
done = execution.step(steps)
seconds = time.perf_counter() - begin
if not done:
    raise SystemExit("libcosim did not take all steps")
series = [
    observer.time_series_real_samples(*places[signal], from_step=0, sample_count=steps + 1)
    for signal in given["signals"]
]
times = [nanoseconds * 1e-9 for nanoseconds in series[0][0]]
leave(given["signals"], zip(times, *(samples for _, _, samples in series), strict=True), seconds)
