"""From a measured log to the effect that the model lacks."""

from dmptm_ctrl.diagnosis.diagnose import diagnose
from dmptm_ctrl.diagnosis.predict import predict
from dmptm_ctrl.diagnosis.report import Diagnosis

__all__ = ["Diagnosis", "diagnose", "predict"]
