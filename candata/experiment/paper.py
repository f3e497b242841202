"""The figures that arXiv 2601.12796 prints, for the table to stand beside.

Source: "Contact-Aware Neural Dynamics", arXiv 2601.12796, its table and text; ADD-S AUC and success in shares. Its
single column is a mustard bottle, its multi column 40 YCB objects.
"""

from __future__ import annotations

from collections.abc import Mapping

from candata.experiment.results import PaperFigures

#: By column, model and regime.
FIGURES: Mapping[tuple[str, str, str], PaperFigures] = {
    ("single", "mlp", "real-finetune"): PaperFigures(adds_auc=0.7743),
    ("single", "unet", "real-finetune"): PaperFigures(adds_auc=0.7011),
    ("single", "diffusion_unet", "real-finetune"): PaperFigures(adds_auc=0.8245),
    ("single", "contact_diffusion", "real-finetune"): PaperFigures(adds_auc=0.8823, success=0.737, mse=0.0082),
    ("single", "contact_diffusion", "real"): PaperFigures(success=0.526),
    ("single", "particle", "sim"): PaperFigures(adds_auc=0.7101),
    ("single", "particle", "real"): PaperFigures(adds_auc=0.6872),
    ("multi", "mlp", "real-finetune"): PaperFigures(adds_auc=0.7343),
    ("multi", "unet", "real-finetune"): PaperFigures(adds_auc=0.7412),
    ("multi", "diffusion_unet", "real-finetune"): PaperFigures(adds_auc=0.7582),
    ("multi", "contact_diffusion", "real-finetune"): PaperFigures(adds_auc=0.7912, success=0.647, mse=0.0058),
    ("multi", "contact_diffusion", "real"): PaperFigures(success=0.471),
    ("multi", "particle", "sim"): PaperFigures(adds_auc=0.6160),
    ("multi", "particle", "real"): PaperFigures(adds_auc=0.6298),
}


def paper_figures(column: str, model: str | None, regime: str | None) -> PaperFigures | None:
    """Return what the paper prints for a row; None where it prints nothing."""
    return FIGURES.get((column, str(model), str(regime)))
