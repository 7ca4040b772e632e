"""sapopt: sequential assignment problems, solved by every method of the field, with proven bounds."""

from sapopt.assignment import assign
from sapopt.benefits import Benefits
from sapopt.certificate import Bound, Certificate, CertificateError, verify
from sapopt.control import Progress
from sapopt.dynamics import SwitchingCost
from sapopt.feasibility import InfeasibleError
from sapopt.matrices import GainMatrix
from sapopt.outlook import Outlook, rollout
from sapopt.problem import SAP
from sapopt.result import Evaluation, Result, Status
from sapopt.verbs import bound, certify, solve

__version__ = "0.1.0"

__all__ = [
    "SAP",
    "Benefits",
    "Bound",
    "Certificate",
    "CertificateError",
    "Evaluation",
    "GainMatrix",
    "InfeasibleError",
    "Outlook",
    "Progress",
    "Result",
    "Status",
    "SwitchingCost",
    "assign",
    "bound",
    "certify",
    "rollout",
    "solve",
    "verify",
]
