"""A drive with effects added to it: what is simulated, fitted, saved and turned into blocks."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import isnan
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.effects import CATALOGUE

if TYPE_CHECKING:
    import control

    from dmptm_ctrl.simulate.plant import Plant

Floats = NDArray[np.float64]

LOG_LENGTH = "log_length"  # parameter of an effect: of the log that is simulated


@dataclass(frozen=True)
class Model:
    """A declared drive and the effects added to it.

    Attributes
    ----------
    drive : Drive
    effects : mapping
        Effect name → {parameter name: value}; parameters left out take the value of the
        absent effect.

    Raises
    ------
    TypeError
        Something else in the place of the drive.
    KeyError
        An effect that is not in the catalogue, or a parameter that it does not have.
    ValueError
        A value that no drive has, see :meth:`~dmptm_ctrl.drive.Drive.check`, or that is NaN.

    Examples
    --------
    >>> model = dm.Model(dm.paper_drive()).with_effect("unbalance", cosine=8.0, sine=0.0)  # N·m
    >>> blocks = model.to_blocks()  # python-control
    """

    drive: Drive = field(default_factory=paper_drive)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.drive, Drive):
            given = type(self.drive).__name__
            hint = "; read_model makes the model of a rig file" if given == "Rig" else ""
            raise TypeError(f"Model takes a Drive first, not a {given}{hint}")
        self.drive.check()
        if not isinstance(self.effects, Mapping):
            raise TypeError(f"effects of a Model are a dict, not {self.effects!r}")
        for name, parameters in self.effects.items():
            if name not in CATALOGUE:
                known = ", ".join(CATALOGUE)
                raise KeyError(f"no effect {name!r} in the catalogue; it has {known}")
            has = [p.name for p in CATALOGUE[name].parameters]
            if not isinstance(parameters, Mapping):
                raise TypeError(f"effect {name!r} is {parameters!r}; it must be a dict of {has}")
            for key in parameters:
                if key not in has:
                    raise KeyError(f"effect {name!r} has no parameter {key!r}; it has {has}")
                value = parameters[key]
                if not isinstance(value, float | Real):
                    raise TypeError(f"effect {name}: {key} is {value!r}; it must be a number")
                if isnan(value):
                    raise ValueError(f"effect {name}: {key} is NaN; it must be a number")

    def check(self) -> None:
        """Refuse effects whose size is negative where it is a magnitude, as a ValueError."""
        for name, values in self.effects.items():
            for parameter in CATALOGUE[name].parameters:
                value = values.get(parameter.name, 0.0)
                if parameter.low == 0.0 > value:
                    raise ValueError(
                        f"effect {name}: {parameter.name} is {value:g}; it must be zero or more"
                    )

    def with_effect(self, name: str, **parameters: float) -> "Model":
        """Return the model with an effect added or replaced."""
        return Model(self.drive, {**self.effects, name: parameters})

    def without(self, names: Iterable[str]) -> "Model":
        """Return the model without the named effects."""
        gone = set(names)
        return Model(self.drive, {k: v for k, v in self.effects.items() if k not in gone})

    def with_values(self, **values: float) -> "Model":
        """Return the model with parameters of the drive replaced."""
        return Model(self.drive.with_values(**values), self.effects)

    def over(self, seconds: float) -> "Model":
        """Return the model for a log of a length [s], where an effect depends on it."""
        timed = {
            name: {**values, LOG_LENGTH: seconds}
            for name, values in self.effects.items()
            if LOG_LENGTH in CATALOGUE[name].shapes
        }
        return Model(self.drive, {**self.effects, **timed}) if timed else self

    def plant(self) -> "Plant":
        """Return the parts and numbers that the simulator takes."""
        return self._plant

    @cached_property
    def _plant(self) -> "Plant":
        from dmptm_ctrl.simulate.dual import dual_plant

        return dual_plant(self)

    def __getstate__(self) -> dict[str, Any]:
        # kernels are no luggage: where it arrives the plant is made anew
        return {"drive": self.drive, "effects": self.effects}

    @property
    def acting(self) -> list[Effect]:
        """Effects that change anything."""
        return [
            CATALOGUE[name]
            for name, given in self.effects.items()
            if any(given.get(a, 0.0) != 0.0 for a in CATALOGUE[name].amplitudes)
        ]

    @property
    def sites(self) -> set[str]:
        """Sites at which an effect acts."""
        return {effect.site for effect in self.acting}

    def to_blocks(self, **options: Any) -> "control.InterconnectedSystem":
        """Return the model as python-control blocks joined by name.

        Parameters
        ----------
        loop : Loop, optional
            Close the speed loop, in continuous time.
        pade_order : int
            Order of the Padé approximation of a drive or sensor delay.
        contact : {"eq21", "two_state"}
            Contact law of the meshes: paper Eq. 21, or its two-state original, which has the
            position in each gap as a state.
        others : sequence of str
            Names of `params` that belong to blocks of your own beside these.

        Returns
        -------
        InterconnectedSystem
            Inputs u_left, u_right [V], or ref [rad/s] with a loop; outputs as of
            :func:`~dmptm_ctrl.simulate.simulate`, and u_left, u_right with a loop.
            Its `syslist` holds the blocks, each of use alone: amplifiers, bodies, their friction,
            meshes, sensor. A friction block takes the torque on a body without friction [N·m] and
            its motion; it gives the friction [N·m], and 1 where that holds the body at rest.
        A mesh block takes the motion of pinion and ring gear; it gives torque [N·m] and z, the
        angle by which the pinion is ahead [rad], both counted at the pinion.
            Of a rig of any shape inputs and outputs are its inputs and sensors; states are
            position and speed of each group of rigidly joined bodies, named by its first body,
            and what lags, dead times and friction remember.

        Raises
        ------
        TypeError
            Something else in the place of the loop.
        ValueError
            A contact law that does not exist, the two-state law without any damping, an effect of
            negative size, or values that no machine has.

        Notes
        -----
        ``params={"k_m": 3e4}`` in ``control.input_output_response`` and the like replaces values
        of the declared drive, or by their keys those of a rig, as ``body.load.inertia``; and kp,
        ki, limit, bias_l, bias_r of the loop. Other names raise ValueError.
        :func:`~dmptm_ctrl.simulate.blocks.initial_state` gives its state at rest or in motion.
        With ``control.input_output_response`` set ``solve_ivp_kwargs={"max_step": dt}`` for inputs
        sampled at dt, or short pulses are stepped over; it draws inputs as straight lines between
        samples, :func:`dmptm_ctrl.simulate.simulate` holds them.

        Teeth need fine steps. With python-control's default tolerance, a loop shows chatter that
        is not there. Set ``solve_ivp_method="LSODA"``, or tighter ``rtol`` and ``atol`` in
        ``solve_ivp_kwargs``.
        """
        from dmptm_ctrl.simulate.blocks import to_blocks

        return to_blocks(self, **options)
