"""What light passes through, by name (thesis eq 4.2)."""

from coop_envs.worlds.world import Medium

MEDIA = {
    "air": Medium("air"),
    # Clear natural water at 600, 530 and 460 nm; rounded from published absorption spectra of pure water.
    "water": Medium("water", absorption_1_m=(0.25, 0.05, 0.02)),
}
