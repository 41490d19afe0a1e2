"""From a measured log to the effects that the model lacks, and what each is worth."""

from dmptm_ctrl.diagnosis.predict import predict
from dmptm_ctrl.diagnosis.report import Diagnosis
from dmptm_ctrl.diagnosis.run import diagnose

__all__ = ["Diagnosis", "diagnose", "predict"]
