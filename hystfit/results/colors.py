"""Colors of pictures: those of Okabe and Ito, which can also be distinguished with color-vision deficiency."""

MEASURED, HELD_OUT, MODEL, FAINT = "#a6a6a6", "#e69f00", "#0072b2", "#bbbbbb"
DARK = "#8a5a00"  # of HELD_OUT, for text
SECOND = "#d55e00"  # beside MODEL
THIRD = "#009e73"
