"""Sabotage of what a fit and a distillation do about mouth and lids, each as a text replacement and the test that must then fail."""

from __future__ import annotations

from mutations.mutants import Mutant

DISTIL = "avatarrex/distil"
HIDDEN, BAKE, OBSERVE = (f"tests/distil/test_{name}.py" for name in ("hidden", "bake", "observe"))
GAINS = "tests/capture/test_expression_gains.py"

MOUTH: dict[str, Mutant] = {
    "lids seen from the front alone": Mutant(
        "mouth and lids",
        f"{DISTIL}/hidden.py",
        "seen[faces[np.unique(first[first >= 0])]] = True",
        "seen[faces] = True",
        f"{HIDDEN}::test_a_ball_in_a_head_is_hidden_until_the_head_is_opened",
    ),
    "a throat closed inside out": Mutant(
        "mouth and lids",
        f"{DISTIL}/hidden.py",
        "found += [(first, b, c) for b, c in pairwise(rim[1:])]",
        "found += [(first, c, b) for b, c in pairwise(rim[1:])]",
        f"{HIDDEN}::test_caps_close_a_tube_with_its_orientation",
    ),
    "a mean of folded poses": Mutant(
        "mouth and lids",
        f"{DISTIL}/bake.py",
        "merged[rows] = np.where(count[:, None] > 0, (low + high) / 2, merged[rows])",
        "del count, low, high",
        f"{BAKE}::test_one_pose_that_folds_the_hem_leaves_no_trace",
    ),
    "hidden flesh stays behind": Mutant(
        "mouth and lids",
        f"{DISTIL}/observe.py",
        "kept = np.where(skin, kept, near / np.maximum(weight, 1e-9))",
        "kept = np.where(skin, kept, near)",
        f"{OBSERVE}::test_what_is_hidden_goes_with_the_skin_around_it",
    ),
    "skin smoothed with what it hides": Mutant(
        "mouth and lids",
        f"{DISTIL}/observe.py",
        "kept = np.where(skin, kept, near / np.maximum(weight, 1e-9))",
        "kept = near / np.maximum(weight, 1e-9)",
        f"{OBSERVE}::test_between_two_lips_it_is_the_mean_and_skin_keeps_its_own",
    ),
    "a gaze from within the lips": Mutant(
        "mouth and lids",
        f"{DISTIL}/observe.py",
        "eye = torch.cat([around.mean(0)[:2], around[:, 2].amax()[None]])",
        "eye = around.mean(0)",
        f"{OBSERVE}::test_the_gaze_starts_as_far_in_front_as_the_lips_reach",
    ),
    "gains that know the points' colours": Mutant(
        "mouth and lids",
        "avatarrex/capture/fit/expression_gains.py",
        "form - same @ common.reshape(-1, count)",
        "form",
        f"{GAINS}::test_colours_are_eliminated_exactly",
    ),
    "gains drawn away from the template's": Mutant(
        "mouth and lids",
        "avatarrex/capture/fit/expression_gains.py",
        "pull / POINTS_A_VOTE - (gains - 1)",
        "pull / POINTS_A_VOTE + (gains - 1)",
        f"{GAINS}::test_pictures_that_show_little_change_little",
    ),
}
