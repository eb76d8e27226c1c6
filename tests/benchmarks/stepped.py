"""Step an FMU with nothing but FMPy and print the duration of each round.

This needs a separate process: in one that has imported the Python module `mujoco`, libmujoco
queries that module's clock at every stage of every step, which makes the arm 10 % slower.

    python stepped.py FMU STOP STEPS ROUNDS [OUTPUT...]
"""

import json
import shutil
import sys
import time

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

file, stop, steps, rounds, *outputs = sys.argv[1:]
description = read_model_description(file, validate=False)
references = [v.valueReference for v in description.modelVariables if v.name in outputs]
folder = extract(file)
fmu = FMU2Slave(
    guid=description.guid,
    unzipDirectory=folder,
    modelIdentifier=description.coSimulation.modelIdentifier,
    instanceName="stepped",
)
fmu.instantiate()
step = float(stop) / int(steps)
seconds = []
for _ in range(int(rounds)):
    fmu.setupExperiment(startTime=0.0, stopTime=float(stop))
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    begin = time.perf_counter()
    for k in range(int(steps)):
        fmu.doStep(currentCommunicationPoint=k * step, communicationStepSize=step)
        if references:
            fmu.getReal(references)
    seconds.append(time.perf_counter() - begin)
    fmu.reset()
fmu.freeInstance()
shutil.rmtree(folder)
assert "mujoco" not in sys.modules
json.dump(seconds, sys.stdout)
