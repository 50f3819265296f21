"""How good an estimate is: errors against truth, consistency, outages, and how sure that is.

`errors` pairs an estimate with the truth once, as columns; everything else is computed from
those columns: `score` and `score_errors` (named metrics), `error_growth` (outages) and
`paired_difference` (two estimates at the same instants). `judge` does it for a whole result;
`judge_requirements` says whether the errors meet what automated driving asks.
"""

from fgloc.evaluation.against_truth import MAX_GAP_S, Errors, check_points, errors
from fgloc.evaluation.bootstrap import Bootstrap, paired_difference, paired_ratio
from fgloc.evaluation.consistency import anees_band, chi2_quantile, effective_samples, nees
from fgloc.evaluation.gaps import Growth, Spans, error_growth, gnss_outages, outages, used_fixes_ns
from fgloc.evaluation.judgement import Judgement, judge, judge_trajectory
from fgloc.evaluation.metric import Metric
from fgloc.evaluation.posts import score_posts
from fgloc.evaluation.requirements import Answer, Requirement, judge_requirements
from fgloc.evaluation.scoring import score, score_errors

__all__ = [
    "MAX_GAP_S",
    "Answer",
    "Bootstrap",
    "Errors",
    "Growth",
    "Judgement",
    "Metric",
    "Requirement",
    "Spans",
    "anees_band",
    "check_points",
    "chi2_quantile",
    "effective_samples",
    "error_growth",
    "errors",
    "gnss_outages",
    "judge",
    "judge_requirements",
    "judge_trajectory",
    "nees",
    "outages",
    "paired_difference",
    "paired_ratio",
    "score",
    "score_errors",
    "score_posts",
    "used_fixes_ns",
]
