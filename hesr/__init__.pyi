from cosim.regressor import FrictionRegressor as FrictionRegressor
from cosim.systems.signals import Signals as Signals
from cosim.systems.system_file import System as System
from cosim.workflow.check import check as check
from cosim.workflow.excite import excite as excite
from cosim.workflow.export import export as export
from cosim.workflow.fit import fit as fit
from cosim.workflow.fit import laws as laws
from cosim.workflow.identify import identify as identify
from cosim.workflow.inspect import inspect as inspect
from cosim.workflow.new import new as new
from cosim.workflow.report import report as report
from cosim.workflow.run import run as run
from cosim.workflow.simulate import simulate as simulate
from cosim.workflow.test import test as test
from fmu_src.run.fmu_file import Fmu as Fmu
from hesr.extras.adaptive.workflow import monitor as monitor
from hesr_model.errors import HesrError as HesrError
from hesr_model.friction.model import FrictionModel as FrictionModel
from hesr_model.logs.robot_log import RobotLog
from hesr_model.rigid_body.identification import RigidBody as RigidBody
from hesr_model.robots.robot import RobotModel

Log = RobotLog
Robot = RobotModel
