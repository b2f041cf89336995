"""A servo in Python around an FMU of three_axis, with fmpy: the waist goes to 0.2 rad.

python -m arm_emulator fmu three_axis --out arm.fmu && python simulate_fmu.py arm.fmu
"""

import sys

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

PERIOD = 1e-3  # s, of the servo: the FMU's fixedInternalStepSize
COUNT = 0.01 * 2.0 * np.pi / 1024  # rad of a joint per encoder count: gear 1/100, 1024 counts
GAIN = 100.0  # V/rad, at the joint
TARGET = np.array([0.2, 0.5, 0.8])  # rad

if len(sys.argv) != 2 or not sys.argv[1].endswith(".fmu"):
    sys.exit("simulate_fmu: one FMU must be named, such as arm.fmu")
folder = extract(sys.argv[1])
description = read_model_description(folder)
reference = {variable.name: variable.valueReference for variable in description.modelVariables}
arm = FMU3Slave(
    guid=description.guid,
    unzipDirectory=folder,
    modelIdentifier=description.coSimulation.modelIdentifier,
    instanceName="arm",
)
arm.instantiate()
arm.enterInitializationMode(startTime=0.0)
arm.exitInitializationMode()
for tick in range(1000):
    counts = np.array(arm.getInt64([reference["encoder_counts"]], nValues=3))
    arm.setFloat64([reference["command"]], GAIN * (TARGET - COUNT * (counts + 0.5)))
    arm.doStep(currentCommunicationPoint=tick * PERIOD, communicationStepSize=PERIOD)
print("q [rad]:", np.round(arm.getFloat64([reference["truth.q"]], nValues=3), 4))
arm.terminate()
arm.freeInstance()
