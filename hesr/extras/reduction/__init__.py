"""Three numbers per joint for simulators: Coulomb friction, damping and armature."""
