"""The code of the modules for Isaac Lab and Pinocchio, around the values that ``simulators`` puts in."""

ISAAC = '''"""A robot for Isaac Lab, written by dynident; URDF, with the identified inertias, is to lie beside it.

`articulation()` returns its configuration, `events()` terms that draw friction and rotor inertia within RANGES, which
hold with a probability of 95 %. Values are in N m, N m s/rad and kg m^2, or in N, N s/m and kg for sliding joints; for
friction that needs Isaac Sim 5.0 or newer. Commands come DELAY (s) late: a DelayedPDActuatorCfg has that. GRAVITY is in
the frame of the base, and BASE_ORIENTATION (w, x, y, z) turns the base so that it points down.
"""

import re
from pathlib import Path

#LITERALS


def _by_joint(values):
    """Return values by expressions for the names of joints, None where there are none."""
    return {re.escape(name): value for name, value in values.items()} or None


def articulation(prim_path="{ENV_REGEX_NS}/Robot", folder=Path(__file__).parent):
    """Return the ArticulationCfg of the robot whose URDF is in the folder."""
    import isaaclab.sim as sim_utils
    from isaaclab.actuators import ImplicitActuatorCfg
    from isaaclab.assets import ArticulationCfg

    converter = sim_utils.UrdfConverterCfg
    gains = converter.JointDriveCfg.PDGainsCfg(stiffness=0.0, damping=0.0)
    return ArticulationCfg(
        prim_path=prim_path,
        spawn=sim_utils.UrdfFileCfg(
            asset_path=str(Path(folder, URDF)),
            fix_base=True,
            merge_fixed_joints=False,
            joint_drive=converter.JointDriveCfg(gains=gains),
        ),
        init_state=ArticulationCfg.InitialStateCfg(rot=BASE_ORIENTATION),
        actuators={
            "arm": ImplicitActuatorCfg(
                joint_names_expr=list(_by_joint(ARMATURE)),
                stiffness=_by_joint(STIFFNESS),
                damping=_by_joint(DAMPING),
                armature=_by_joint(ARMATURE),
                friction=_by_joint(FRICTION),
                dynamic_friction=_by_joint(FRICTION),
                viscous_friction=_by_joint(VISCOUS_FRICTION),
                effort_limit_sim=_by_joint(EFFORT_LIMIT),
            )
        },
    )


def events(asset="robot"):
    """Return the event terms by name, which draw values at each reset."""
    from isaaclab.envs import mdp
    from isaaclab.managers import EventTermCfg, SceneEntityCfg

    terms = {}
    for attribute in ("armature", "friction"):
        for joint, limits in RANGES.get(attribute, {}).items():
            parameters = {
                "asset_cfg": SceneEntityCfg(asset, joint_names=[re.escape(joint)]),
                f"{attribute}_distribution_params": limits,
                "operation": "abs",
            }
            terms[f"{attribute} {joint}"] = EventTermCfg(
                func=mdp.randomize_joint_parameters, mode="reset", params=parameters
            )
    return terms
'''

PINOCCHIO = '''"""A robot for Pinocchio, written by dynident. Run this file, and it checks itself.

Values are in N m, N m s/rad and kg m^2, or in N, N s/m and kg for sliding joints; ARMATURE is that of the rotors at the
joints. RANGES hold with a probability of 95 %. STATES are positions, velocities and accelerations, TORQUES theirs.
"""

import numpy as np
import pinocchio as pin

#LITERALS


def load():
    """Return the model, with rotor inertia, gear ratio, armature, damping and friction of its joints."""
    model = pin.buildModelFromXML(URDF)
    model.gravity = pin.Motion(np.array(GRAVITY), np.zeros(3))
    names = "rotorInertia", "rotorGearRatio", "armature", "damping", "friction"
    arrays = {name: np.array(getattr(model, name)) for name in names}
    for joint in JOINTS:
        k, gear = model.joints[model.getJointId(joint)].idx_v, GEAR_RATIO[joint]
        values = ARMATURE[joint] / gear**2, gear, ARMATURE[joint], VISCOUS_FRICTION[joint], FRICTION[joint]
        for name, value in zip(names, values):
            arrays[name][k] = value
    for name, array in arrays.items():
        setattr(model, name, array)
    return model


def inverse_dynamics(model, data, q, dq, ddq):
    """Return the torque of a configuration q with velocity and acceleration; that of rotors and friction is in it."""
    return pin.rnea(model, data, q, dq, ddq) + model.damping * dq + model.friction * np.sign(dq)


def _configuration(model, positions):
    """Return the configuration for positions by joint; a continuous joint is a point of a circle."""
    q = pin.neutral(model)
    for name, x in positions.items():
        joint = model.joints[model.getJointId(name)]
        if model.existJointName(name) and joint.nv == 1:
            q[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
    return q


def check(tolerance=1e-8):
    """Compare the torques of STATES with TORQUES; ValueError where they differ by more than a share of the largest."""
    model = load()
    data = model.createData()
    for q, dq, ddq, expected in zip(*STATES, TORQUES):
        positions, rates, columns = dict(FIXED_POSITIONS), np.zeros((2, model.nv)), {}
        for name, (leader, factor, offset) in DRIVEN.items():
            k = JOINTS.index(leader)
            columns[name] = model.joints[model.getJointId(name)].idx_v
            positions[name] = factor * q[k] + offset
            rates[:, columns[name]] = factor * dq[k], factor * ddq[k]
        torque = inverse_dynamics(model, data, _configuration(model, positions), *rates)
        joint_torque = [0.0] * len(JOINTS)
        for name, (leader, factor, _) in DRIVEN.items():
            joint_torque[JOINTS.index(leader)] += factor * torque[columns[name]]
        if not np.abs(np.subtract(joint_torque, expected)).max() <= tolerance * np.abs(TORQUES).max():
            raise ValueError(f"the torque is {joint_torque}, expected is {expected}")


if __name__ == "__main__":
    check()
    print(f"The torques of {len(TORQUES)} states are as expected.")
'''
