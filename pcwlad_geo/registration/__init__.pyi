from .assessment import conclude, fit_pair
from .decision import Decision
from .inputs import InputFile, Inputs, check_output, estimate_tile_count, requested_grid, resolve
from .matching import match_pair
from .motions import Motion
from .opening import prepare_pair
from .point_file import Origin
from .quality import (
    FAIR_PX,
    GOOD_PX,
    GRADES,
    Grade,
    Quality,
    QualityParameters,
    Reason,
    grade_of,
    grade_of_error,
    worst_first,
)
from .result import Matches, Pair, PairGeometry, Registration, RegistrationStatus
from .rpc import CorrectedRpc, RpcRegistration
from .run import prove_pair, register_inputs, register_pair
from .starts.alignment import Prealignment
from .starts.pose import Pose

__all__ = [
    "FAIR_PX",
    "GOOD_PX",
    "GRADES",
    "CorrectedRpc",
    "Decision",
    "Grade",
    "InputFile",
    "Inputs",
    "Matches",
    "Motion",
    "Origin",
    "Pair",
    "PairGeometry",
    "Pose",
    "Prealignment",
    "Quality",
    "QualityParameters",
    "Reason",
    "Registration",
    "RegistrationStatus",
    "RpcRegistration",
    "check_output",
    "conclude",
    "estimate_tile_count",
    "fit_pair",
    "grade_of",
    "grade_of_error",
    "match_pair",
    "prepare_pair",
    "prove_pair",
    "register_inputs",
    "register_pair",
    "requested_grid",
    "resolve",
    "worst_first",
]
