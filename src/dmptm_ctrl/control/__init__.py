"""Speed loops on linear models: PI controller, closed loop, tuning."""

from dmptm_ctrl.control.pi import close_speed_loop, common_mode, pi_controller
from dmptm_ctrl.control.tuning import PiTuning, assess_pi, tune_pi

__all__ = ["PiTuning", "assess_pi", "close_speed_loop", "common_mode", "pi_controller", "tune_pi"]
