"""The situations: what is wrong, whether the data could show it, and what makes it so; and some that are right."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from situation_arm import Course, Setup
from situation_faults import (
    absolute,
    add,
    backlash,
    both,
    commanded,
    compliance,
    courses,
    differential,
    drifting,
    elastic,
    gains,
    geared,
    geometry,
    hung,
    in_two,
    joined,
    kept,
    late,
    load_friction,
    longer,
    low_passed,
    massless,
    no_friction,
    no_gravity,
    noisy_fast,
    payload,
    position,
    position_spikes,
    put,
    remounted,
    repeated,
    repeated_samples,
    reversed_position,
    ripple,
    role_clock,
    saturated,
    saturating,
    scale,
    scaled,
    simulated,
    spring,
    stale,
    stale_torque,
    stribeck,
    swap,
    tempered,
    tilted,
    time,
    tipped,
    torque,
    torque_spikes,
    turned_round,
    twice,
    unit,
    wall,
    warming,
    without,
    wrapped,
    zero,
)


def two(setup: Setup) -> Setup:
    """Return the setup with a second training log."""
    return replace(setup, paths=courses(second=Course(4)), config=in_two)


class Shown(StrEnum):
    """Whether data could show what is wrong."""

    YES = "yes"
    SMALL = "hardly: less than 3 % of the squared residual, and about 0.5 % of the torque of a faster motion"
    NO = "no"
    RIGHT = "nothing is wrong"


@dataclass(frozen=True)
class Situation:
    """A name, what is wrong, whether the data could show it, and the setup."""

    name: str
    wrong: str
    shown: Shown
    setup: Setup


# what of these situations is the cause, by the class of its note or the effect of its term
CAUSES = {
    "torques-swapped": "JointsSwapped", "positions-swapped": "JointsSwapped", "joints-swapped": "JointsSwapped",
    "torque-sign": "ColumnReversed", "position-sign": "ColumnReversed", "delay-per-joint": "delay of the torque",
    "late-one-joint": "delay of the torque", "clock": "ClockWrong", "ripple": "ripple",
    "saturating": "torque that saturates",
    "differential": "torque of a neighbour", "tilted": "TiltedBase", "hanging": "OtherGravity", "wall": "OtherGravity",
    "hanging-six": "OtherGravity", "gain-double": "TorqueGain", "gain-ten": "TorqueGain", "length-ten": "LengthWrong",
    "length-fifty": "LengthWrong", "zero": "ZeroOff", "axis-turned": "OtherAxis", "no-rotor": "rotor inertia",
    "no-spring": "spring", "no-coulomb": "Coulomb friction", "no-viscous": "viscous friction",
    "load-friction": "load-dependent friction", "stribeck": "Stribeck friction", "warming": "friction that drifts",
    "position-gear": "PositionGear", "position-gear-wrist": "PositionGear", "position-gear-six": "PositionGear",
    "gain-hundred": "OddScale", "drifting": "gain that drifts", "late-long": "TimeOffset", "milli": "OddScale",
    "repeated-samples": "RepeatedPositions", "temperature-one-log": "OddLog", "backlash": "LeftAtReversals",
    "elastic": "LeftAtReversals", "held-out-scaled": "Repeats", "held-out-slowed": "Repeats",
    "small-motion": "Uncertain", "torque-low-passed": "LowPassed", "position-low-passed": "TimeOffset",
    "commanded": "TimeOffset",
}  # fmt: skip
MIDDLE, SECOND = np.s_[800:1200, 1], np.s_[:, 1]
YES, SMALL, NO, RIGHT = Shown.YES, Shown.SMALL, Shown.NO, Shown.RIGHT
SITUATIONS = (
    # the log
    Situation("torque-sample", "one torque sample is 5000 N m", YES, Setup(fault=torque(put((777, 1), 5e3), "train"))),
    Situation("torque-spikes", "0.1 % of the torques are spikes", YES, Setup(fault=torque(torque_spikes))),
    Situation("position-spike", "one position is 0.5 rad off", YES, Setup(fault=position(add((900, 1), 0.5), "train"))),
    Situation("position-spikes", "five positions are 5 mrad off", YES, Setup(fault=position(position_spikes))),
    Situation("wrap", "the position of joint 1 wraps at pi", YES, Setup(fault=wrapped)),
    Situation("torque-frozen", "a torque is frozen for 2 s", YES, Setup(fault=torque(put(MIDDLE, 5.0)))),
    Situation("torque-zeroed", "a torque is zero for 2 s", YES, Setup(fault=torque(put(MIDDLE, 0.0)))),
    Situation("position-frozen", "a position is frozen for 0.5 s", YES,
              Setup(fault=position(put(np.s_[800:900, 1], 0.4)))),
    Situation("torque-saturated", "a torque is clipped at 70 % of its largest", YES, Setup(fault=torque(saturated))),
    Situation("torques-swapped", "the torque columns of joints 2 and 3 are swapped", YES,
              Setup(fault=torque(swap(1, 2)))),
    Situation("positions-swapped", "the position columns of joints 2 and 3 are swapped", YES,
              Setup(fault=position(swap(1, 2)))),
    Situation("joints-swapped", "positions and torques of joints 2 and 3 are swapped", YES,
              Setup(fault=both(position(swap(1, 2)), torque(swap(1, 2))))),
    Situation("torque-sign", "the torque of joint 2 has the other sign", YES, Setup(convention=gains(1, -1, 1))),
    Situation("position-sign", "the position of joint 2 has the other sign", YES, Setup(convention=reversed_position)),
    Situation("same-file", "the held-out log is the training file", YES, Setup(config=twice)),
    Situation("repeat-shifted", "the held-out log repeats the motion, 0.25 s later", YES,
              Setup(paths=courses(validation=Course(1)), fault=repeated(start=0.25))),
    Situation("ms-as-s", "stamps in ms are declared s", YES, Setup(fault=time(lambda t, _: 1e3 * t))),
    Situation("ns-as-s", "stamps in ns are declared s", YES, Setup(fault=time(lambda t, _: 1e9 * t))),
    Situation("s-as-ms", "stamps in s are declared ms", YES, Setup(config=unit("time", "ms"))),
    Situation("deg-as-rad", "positions in deg are declared rad", YES, Setup(fault=scaled(180 / np.pi))),
    Situation("rad-as-deg", "positions in rad are declared deg", YES, Setup(config=unit("position", "deg"))),
    Situation("gravity-compensated", "torque after gravity compensation", YES, Setup(effect=no_gravity)),
    Situation("friction-compensated", "torque after friction compensation", YES, Setup(effect=no_friction)),
    Situation("delay-per-joint", "torques are 0, 5 and 10 ms late", YES, Setup(fault=late(0.0, 0.005, 0.010))),
    Situation("position-rate", "positions have a quarter of the rate of torques", YES, Setup(fault=stale)),
    Situation("milli", "the torque of joint 2 is in mN m", YES, Setup(convention=gains(1, 1e3, 1))),
    Situation("joined", "two pieces are joined, with a jump", YES, Setup(fault=joined)),
    Situation("slow", "slow motion only", YES,
              Setup(paths=courses(train=Course(1, 0.1), validation=Course(2, 0.1)))),
    Situation("joint-at-rest", "joint 2 is at rest in training", YES,
              Setup(paths=courses(train=Course(1, still=(1,)), validation=Course(2, still=(1,))))),
    Situation("payload-held-out", "a payload of 2 kg in the held-out log only", YES,
              Setup(effect=payload("validation"))),
    Situation("payload-training", "a payload of 2 kg in training only", YES, Setup(effect=payload("train"))),
    # found by a sceptic, once the others were
    Situation("spikes-kept", "0.1 % of the torques in training are spikes, which are kept", YES,
              Setup(fault=torque(torque_spikes, "train"), config=kept)),
    Situation("late-one-joint", "the torque of joint 3 is 8 ms late", YES, Setup(fault=late(0.0, 0.0, 0.008))),
    Situation("swapped-one-log", "torque columns are swapped in one of two training logs", YES,
              two(Setup(fault=torque(swap(1, 2), "second")))),
    Situation("gain-one-log", "the gain of joint 2 is 15 % off in one of two training logs", YES,
              two(Setup(fault=torque(scale(SECOND, 1.15), "second")))),
    Situation("payload-one-log", "a payload of 0.3 kg in one of two training logs", YES,
              two(Setup(effect=payload("second", mass=0.3)))),
    Situation("zero-one-log", "the zero of joint 2 is 0.1 rad off in one of two training logs", YES,
              two(Setup(fault=position(add(SECOND, 0.1), "second")))),
    Situation("zero-held-out", "the zero of joint 2 is 0.1 rad off in the held-out log", YES,
              Setup(fault=position(add(SECOND, 0.1), "validation"))),
    Situation("tilted-held-out", "the base is tilted by 2 degrees in the held-out log", YES, Setup(effect=remounted)),
    Situation("clock", "a second of the stamps is 0.83 s", YES, Setup(fault=time(lambda t, _: 1.2 * t))),
    Situation("held", "positions and torques are held for four samples", YES, Setup(fault=both(stale, stale_torque))),
    Situation("backlash", "positions of motors with play", YES, Setup(convention=backlash)),
    Situation("elastic", "positions of motors behind elastic gears", YES, Setup(convention=elastic)),
    Situation("saturating", "the current shows less and less of the torque of joint 2", YES,
              Setup(convention=saturating)),
    Situation("absolute", "the position of joint 3 is against the base", YES, Setup(convention=absolute)),
    Situation("differential", "the torque of joint 2 contains that of joint 3", YES, Setup(convention=differential)),
    Situation("ripple", "the motors cog, 2 N m twelve times a turn", YES, Setup(effect=ripple)),
    # found by another sceptic
    Situation("position-gear", "the position gear of joint 2 is 5 % off", YES, Setup(convention=geared(1, 1.05, 1))),
    Situation("position-gear-wrist", "the position gear of joint 3 is 5 % off", YES,
              Setup(convention=geared(1, 1, 1.05))),
    Situation("position-gear-six", "the position gear of joint 5 of six is 5 % off", YES,
              Setup("six", convention=geared(1, 1, 1, 1, 1.05))),
    Situation("position-gear-hundred", "the gear of joint 3 is 100 times off, for position and torque", YES,
              Setup(convention=lambda q, tau: (q * np.array([1, 1, 100]), tau / np.array([1, 1, 100])))),
    Situation("gain-hundred", "the gain of joint 3 is 100 times off", YES, Setup(convention=gains(1, 1, 100))),
    Situation("torque-low-passed", "torques are low-passed at 5 Hz", YES, Setup(fault=low_passed("tau", 5.0))),
    Situation("position-low-passed", "positions are low-passed at 5 Hz", YES, Setup(fault=low_passed("q", 5.0))),
    Situation("commanded", "positions are those commanded", YES, Setup(fault=commanded)),
    Situation("drifting", "the gain of joint 2 rises by 15 % over each log", YES, Setup(fault=torque(drifting))),
    Situation("repeated-samples", "a tenth of the samples is repeated", YES, Setup(fault=repeated_samples)),
    Situation("clock-training", "the clock of the training is 3 % fast", YES, Setup(fault=role_clock(1.03, "train"))),
    Situation("clock-three", "the clock of all logs is 3 % fast", NO, Setup(fault=time(lambda t, _: 1.03 * t))),
    Situation("temperature-one-log", "one of two training logs is of a cold robot", YES, two(Setup(effect=tempered))),
    Situation("late-long", "all torques are 60 ms late", YES, Setup(fault=late(0.06, 0.06, 0.06))),
    Situation("small-motion", "motions of 3 degrees", YES,
              Setup(paths=courses(train=Course(1, 1.0, 0.05), validation=Course(2, 1.0, 0.05)))),
    Situation("held-out-scaled", "the held-out motion is the training times 0.9", YES,
              Setup(paths=courses(validation=Course(1, 1.0, 0.81)))),
    Situation("held-out-slowed", "the held-out motion is the training at 0.9 of its speed", YES,
              Setup(paths=courses(validation=Course(1, 0.9)))),
    # the robot
    Situation("hanging", "the arm hangs, the file says that it stands", YES, Setup(robot=hung)),
    Situation("hanging-six", "an arm of six joints hangs", YES, Setup("six", robot=hung)),
    Situation("wall", "the arm is on a wall", YES, Setup(robot=wall)),
    Situation("tilted", "the base is tilted by 2 degrees", YES, Setup(robot=tilted)),
    Situation("gain-double", "the gain of joint 2 is 2x", YES, Setup(convention=gains(1, 2, 1))),
    Situation("gain-ten", "the gain of joint 2 is 10 % off", YES, Setup(convention=gains(1, 1.1, 1))),
    Situation("gains-ten", "all gains are 10 % off", NO, Setup(convention=gains(1.1, 1.1, 1.1))),
    Situation("gains-sign", "all torques have the other sign", YES, Setup(convention=gains(-1, -1, -1))),
    Situation("length-ten", "a link is 10 % longer in the file", YES, Setup(links=longer(1.1))),
    Situation("length-fifty", "a link is 50 % longer in the file", YES, Setup(links=longer(1.5))),
    Situation("zero", "the zero of joint 2 is off by 0.1 rad", YES, Setup(convention=zero(0.0, 0.1))),
    Situation("zero-vertical", "the zero of joint 1 (vertical) is off by 0.1 rad", NO, Setup(convention=zero(0.1))),
    Situation("axis-turned", "the axis of joint 3 is turned by 90 degrees in the file", YES,
              Setup(links=geometry(2, lambda link: replace(link, axis=(1.0, 0.0, 0.0))))),
    Situation("axis-tilted", "the axis of joint 3 is tilted by 3 degrees in the file", SMALL,
              Setup(links=geometry(2, tipped))),
    Situation("no-rotor", "rotor inertia is left out of the model", YES, Setup(config=without("rotor"))),
    Situation("no-spring", "a spring of joint 2 is left out", YES, Setup(effect=spring)),
    Situation("no-coulomb", "Coulomb friction is left out", YES, Setup(config=without("coulomb"))),
    Situation("no-viscous", "viscous friction is left out", YES, Setup(config=without("viscous"))),
    Situation("load-friction", "friction grows with the load", YES, Setup(effect=load_friction)),
    Situation("stribeck", "friction is larger at low speed", YES, Setup(effect=stribeck)),
    Situation("compliance", "the joints are elastic (6 Hz)", YES, Setup(effect=compliance)),
    Situation("warming", "friction falls by 40 % while the robot warms up", YES, Setup(effect=warming)),
    # nothing is wrong, or nothing that does harm
    Situation("right", "three joints", RIGHT, Setup()),
    Situation("right-simulated", "three joints, with a free simulation", RIGHT, Setup(config=simulated)),
    Situation("right-six", "six joints", RIGHT, Setup("six")),
    Situation("right-two", "two training logs", RIGHT, two(Setup())),
    Situation("right-slower", "the held-out motion is slower", RIGHT, Setup(paths=courses(validation=Course(2, 0.6)))),
    Situation("late", "all torques are 5 ms late, which is sought", RIGHT, Setup(fault=late(0.005, 0.005, 0.005))),
    Situation("quantised", "torques have steps of 0.5 N m", RIGHT,
              Setup(fault=lambda raw, _rng, _role: replace(raw, tau=np.round(2 * raw.tau) / 2))),
    Situation("jitter", "stamps have a jitter of 20 us", RIGHT,
              Setup(fault=time(lambda t, rng: t + 2e-5 * rng.standard_normal(len(t))))),
    Situation("noisy-fast", "the noise of the torque grows with the speed", RIGHT, Setup(fault=noisy_fast)),
    Situation("massless", "the file's masses are zero", RIGHT, Setup(links=massless)),
    Situation("order", "the file lists its links in another order", RIGHT, Setup(text=turned_round)),
)  # fmt: skip
