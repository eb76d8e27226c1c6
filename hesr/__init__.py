"""From a robot's log to a friction model as an FMU, with proof that it works.

Every command of `hesr` is a function, and every object a class::

    import hesr

    log = hesr.Log.read("sweep.csv", robot="robot.toml")     # or a URDF, or an MJCF
    friction = hesr.FrictionRegressor(law="lugre").fit(log)
    print(friction.equation(), friction.score(hesr.Log.read("test.csv", robot="robot.toml")))
    friction.to_fmu("Friction.fmu")

Objects   Robot, Log, RigidBody, FrictionModel, FrictionRegressor, Fmu, System, Signals;
          HesrError, the base of all errors
Commands  new, inspect, excite, identify, fit, test, export, check, simulate, run, report, monitor;
          laws, the laws that `fit` knows; observe, the external torque over logs
Own laws  OneForm, LawForm, Coefficient, SearchSpace, Relaxation, Stop, register, Estimator,
          FrictionLaw; DQ, Q, TAU_LOAD, the inputs; sgn, absolute, sign and magnitude
Plug-ins  FileFormat, LogSamples, RobotDescription, LogError (log formats); Exporter, ExportOption,
          ExportError (export formats); Component, Quantity, Parameter, Equation, Requirement,
          previous, DT, block, write_fmu (components as FMUs)

A path is text or a path object. A parameter of several items takes one item, or any iterable. Logs,
bodies, laws, FMUs and results show themselves as tables in a notebook; logs and signals have
`to_pandas()`, logs also `to_xarray()`. The stub `__init__.pyi` is the list of names; each is
imported when it is first used. `__version__` is the version.
"""

from hesr_model.support.lazy import lazy

__getattr__, __dir__ = lazy(__name__, __file__)
