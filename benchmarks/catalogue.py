"""Every study of the report, in the order of the page."""

from collections.abc import Iterable, Sequence

from f4x_core.errors import F4xError

from .study import SECTIONS, Study

STUDIES = (
    Study(
        "peaks",
        "limit",
        "What this machine can do",
        "How many multiply-adds and bytes a second the kernels could have at best.",
        ".studies.physical_limit:measure_peaks",
    ),
    Study(
        "kernel-shares",
        "limit",
        "Kernels",
        "Which share of this machine's multiply-adds and copies does each compiled kernel reach?",
        ".studies.kernel_shares:measure_kernels",
    ),
    Study(
        "raster-backends",
        "speed",
        "Rasteriser: backends",
        "What does each way to draw cost, and how far is it from the float64 reference?",
        ".studies.raster_curves:measure_backends",
    ),
    Study(
        "raster-precision-and-cut-offs",
        "speed",
        "Rasteriser: precision and cut-offs",
        "What do float32, float16, the alpha cut and the early stop save, and what do they cost in error?",
        ".studies.raster_curves:measure_cut_offs",
    ),
    Study(
        "raster-tiles",
        "speed",
        "Rasteriser: tiles",
        "Which tile size is fastest, and does any change the picture?",
        ".studies.raster_curves:measure_tiles",
    ),
    Study(
        "raster-channels",
        "speed",
        "Rasteriser: channels",
        "What does a wider feature cost?",
        ".studies.raster_curves:measure_channels",
        seed_tables=("D",),
    ),
    Study(
        "raster-size",
        "speed",
        "Rasteriser: size of the picture",
        "How do time and error grow with pixels?",
        ".studies.raster_curves:measure_sizes",
    ),
    Study(
        "raster-count",
        "speed",
        "Rasteriser: number of Gaussians",
        "How do time and error grow with Gaussians?",
        ".studies.raster_curves:measure_counts",
    ),
    Study(
        "raster-gradients",
        "speed",
        "Rasteriser: gradients",
        "How far is every gradient from the float64 one, and is that one right?",
        ".studies.raster_curves:measure_gradients",
    ),
    Study(
        "deformation-forms",
        "speed",
        "Deformation: forms of the blend",
        "What do linear blending, dual quaternions and the exact mean cost, and how far apart are they?",
        ".studies.deformation_curves:measure_forms",
    ),
    Study(
        "deformation-rotations",
        "speed",
        "Deformation: every angle",
        "How wrong is each form between a node at rest and one that turns by 0 to 359 degrees?",
        ".studies.deformation_curves:measure_rotations",
    ),
    Study(
        "neighbours",
        "speed",
        "Nearest neighbours",
        "What do exact, approximate and sampled searches for nodes cost, and whom do they get wrong?",
        ".studies.neighbour_curves:measure_neighbours",
    ),
    Study(
        "curve-distance",
        "speed",
        "Distance of curves",
        "Do some frames tell how far two trajectories ever get apart?",
        ".studies.neighbour_curves:measure_curve_distance",
    ),
    Study(
        "storage",
        "speed",
        "Storage",
        "How small can a scene be stored, and what do its pictures lose?",
        ".studies.storage:measure_storage",
        seed_tables=("B",),
    ),
    Study(
        "hard-cases",
        "stability",
        "The catalogue of hard cases",
        "Does the program get right what breaks others, or say why it cannot?",
        ".studies.stability:measure_cases",
    ),
    Study(
        "precision",
        "stability",
        "Float32 against float64",
        "Where does single precision hurt: in small and large worlds, and in blends around half a turn?",
        ".studies.stability:measure_precision",
    ),
    Study(
        "fit-profile",
        "speed",
        "Fit: profiles",
        "What does each profile's time buy, on views that no camera had?",
        ".studies.fit_studies:study_profiles",
    ),
    Study(
        "fit-iterations",
        "speed",
        "Fit: steps",
        "How much nearer to the truth do more steps bring the fit?",
        ".studies.fit_studies:study_steps",
    ),
    Study(
        "fit-resolution",
        "speed",
        "Fit: resolution",
        "What do larger pictures cost, and what do they bring?",
        ".studies.fit_studies:study_resolution",
    ),
    Study(
        "fit-budget",
        "speed",
        "Fit: number of Gaussians",
        "How many Gaussians are enough?",
        ".studies.fit_studies:study_budget",
    ),
    Study(
        "mutations",
        "stability",
        "Formulas broken on purpose",
        "Does a test of the everyday suite notice a sign, a factor or a comparison that is wrong?",
        ".studies.mutations:measure_mutations",
        only_full=True,
    ),
    Study(
        "latent-width",
        "speed",
        "Features: width of the latent",
        "What do wider latents cost, and what do they tell apart?",
        ".studies.latent_studies:study_widths",
        seed_tables=("D", "E"),
    ),
    Study(
        "inference",
        "speed",
        "Features: inference in feature space or from rendered pictures",
        "Are the scene's own features quicker than a teacher that looks at its pictures, and as good?",
        ".studies.latent_studies:study_inference",
        seed_tables=("A", "C"),
    ),
    Study(
        "needs-ladder",
        "needs",
        "Toy worlds that need more and more",
        "Is what the program chose neither more nor less than the scene needs?",
        ".studies.needs_studies:study_ladder",
    ),
    Study(
        "needs-clips",
        "needs",
        "Real clips",
        "What did real clips need, and would less have done?",
        ".studies.needs_studies:study_clips",
        only_full=True,
    ),
    Study(
        "ablations",
        "ablations",
        "The fit without one of its parts",
        "Which parts of the method does the picture need?",
        ".studies.ablations:study_ablations",
    ),
    Study(
        "clips-fit",
        "clips",
        "Real clips: fitted",
        "How near does a fitted scene come to pictures that it saw, and to pictures that it didn't?",
        ".studies.clip_studies:fit_clips",
        only_full=True,
    ),
    Study(
        "clips-features",
        "clips",
        "Real clips: asked",
        "What do a word and a mask on one frame find in the whole scene, and what do features cost?",
        ".studies.clip_studies:ask_clips",
        only_full=True,
    ),
    Study(
        "clips-edits",
        "clips",
        "Real clips: edited",
        "How much of the thing does an edit change, and how much else?",
        ".studies.clip_studies:edit_clips",
        only_full=True,
    ),
    Study(
        "rendered-clips",
        "clips",
        "Rendered clips against their truth",
        "How wrong are views that the camera never had, and the cameras that were found?",
        ".studies.clip_studies:fit_rendered",
        only_full=True,
    ),
    Study(
        "rendered-people",
        "clips",
        "Rendered people against their truth",
        "Are they seen as people, where are their joints, which of two limbs is in front, and how far away are they?",
        ".studies.rendered_people:study_people",
        only_full=True,
    ),
    Study(
        "oracle-ladder",
        "clips",
        "Rendered clips: true priors replaced by offline ones",
        "Which prior costs most in views that the camera never had, on what moves and on what stands still?",
        ".studies.oracle_ladder:study_ladder",
    ),
    Study(
        "nvidia",
        "datasets",
        "NVIDIA",
        "Seven scenes by RoDynRF's protocol: how near are views of another camera?",
        ".studies.datasets:study_nvidia",
        seed_tables=("B",),
    ),
    Study(
        "dycheck",
        "datasets",
        "DyCheck",
        "Masked figures of cameras that stand aside, and keypoints carried from frame to frame.",
        ".studies.datasets:study_dycheck",
    ),
    Study(
        "nerfies",
        "datasets",
        "Nerfies",
        "The right camera of a rig whose left one was learnt.",
        ".studies.datasets:study_nerfies",
    ),
    Study(
        "blender",
        "blender",
        "In Blender",
        "What do import, playback, queries and pictures cost inside Blender?",
        ".studies.clip_studies:measure_blender",
        only_full=True,
    ),
)
"""Name, section, what is asked, and the function that measures it."""


def choose(names: Sequence[str] | None) -> list[Study]:
    """Return the studies that `--only` names, by their own name or their section's; all for None.

    Raises:
        F4xError: a name is neither.
    """
    if names is None:
        return list(STUDIES)
    known = {study.name for study in STUDIES} | {study.section for study in STUDIES}
    for name in names:
        if name not in known:
            sections = ", ".join(section for section in SECTIONS if section in known)
            raise F4xError(
                f"--only {name}: no study or part of the report; parts are {sections}; studies: {_listed()}."
            )
    return [study for study in STUDIES if study.name in names or study.section in names]


def _listed() -> str:
    return ", ".join(names_of(STUDIES))


def names_of(studies: Iterable[Study]) -> list[str]:
    """Their names."""
    return [study.name for study in studies]
