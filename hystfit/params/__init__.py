"""Parameters: declared on the fields of a model, collected by name into vectors."""

from hystfit.params.param import ParamInfo as ParamInfo
from hystfit.params.param import param as param
from hystfit.params.space import ParameterSpace as ParameterSpace
