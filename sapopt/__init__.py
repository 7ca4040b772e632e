"""sapopt: sequential assignment problems, solved by every method of the field, with proven bounds."""

from sapopt.api import bound, certify, solve
from sapopt.data.assignment import assign
from sapopt.data.benefits import Benefits
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import GainMatrix
from sapopt.dynamics import SwitchingCost
from sapopt.formulations.limited.why import Explanation, why_not
from sapopt.live.decision import Decision
from sapopt.live.session import Session
from sapopt.problem.limit import Limit, Team
from sapopt.problem.result import Evaluation, Result, Status
from sapopt.problem.rows import LimitUse
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound, Certificate, CertificateError, verify
from sapopt.running.control import Progress
from sapopt.running.outlook import Outlook
from sapopt.running.rollout import rollout

__version__ = "0.1.0"

__all__ = [
    "SAP",
    "Benefits",
    "Bound",
    "Certificate",
    "CertificateError",
    "Decision",
    "Evaluation",
    "Explanation",
    "GainMatrix",
    "InfeasibleError",
    "Limit",
    "LimitUse",
    "Outlook",
    "Progress",
    "Result",
    "Session",
    "Status",
    "SwitchingCost",
    "Team",
    "assign",
    "bound",
    "certify",
    "rollout",
    "solve",
    "verify",
    "why_not",
]
