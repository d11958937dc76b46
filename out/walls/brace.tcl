# hystfit 0.1.0, model bouc-wen-force: input in mm, output in kN
# rms error of the fit 0.291 % of the range, status ok
# estimates and standard errors (1 sd), covariance in the CSV file:
#   kappa_x = 0.40358615 kN/mm, +- 0.0017
#   kappa_w = 11.977983 kN, +- 0.012
#   rho = 0.50058134 1/mm, +- 0.0013
#   sigma = 0.6022389, +- 0.0044
#   n = 1.4987618, +- 0.01
#   offset = -0.0050837192 kN, +- 0.0041
#   w0 = 0, fixed
# offset -0.0050837192 is not in the material
uniaxialMaterial BoucWen 3 0.06306486 6.3995409 1.4987618 0.14099587 0.21347788 1 0 0 0 1.9976774e-08 100
