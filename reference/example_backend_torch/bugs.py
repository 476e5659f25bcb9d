"""What the oracle's diagnosis says of deliberate bugs in the PyTorch backend:  python3 bugs.py TRGS [f64|f32] > RESULT.md"""
import importlib.util, sys
from pathlib import Path

HERE = Path(__file__).parent
spec = importlib.util.spec_from_file_location("shared", HERE.parent / "example_backend/bugs.py")
shared = importlib.util.module_from_spec(spec)
spec.loader.exec_module(shared)

EXACT, AFFINE, FIELD = "image-exact", "image-affine", "density"
U = "p_u = (torch.arange(columns, dtype=REAL) + 0.5 - columns / 2) * width / columns + off_u"
V = "p_v = ((torch.arange(rows, dtype=REAL) + 0.5 - rows / 2) * height / rows - off_v)[:, None]"
START = "off_u, off_v = scanner[\"offDetector\"]"
TURN = "c, s = torch.cos(angle), torch.sin(angle)"
NORMAL = "(quaternion / quaternion.norm(dim=1, keepdim=True)).unbind(1)"
READ = "w, x, y, z = " + NORMAL
GAMMA = "torch.exp(torch.lgamma((safe + 2) / 2) - torch.lgamma((safe + 3) / 2))"
SLOPES = "return [dict(zip(KEYS, slopes(value, *inputs)))]"
SUM = "FIELDS[stage](model, scanner, angles).sum(0)"
ADAM = "x = x - rate * (m / (1 - beta1**t)) / (torch.sqrt(v / (1 - beta2**t)) + epsilon)"
WINDOW = "torch.exp(-((torch.arange(11, dtype=REAL) - 5) ** 2) / (2 * 1.5**2))"
FIELD_POWER = "power(delta, by_primitive(model[\"nu\"], 3), 3)"
IMAGE_POWER = "power(delta, nu, 2)"


def slope(key, change):
    """Gradients with one group changed."""
    return SLOPES, f"g = dict(zip(KEYS, slopes(value, *inputs))); g['{key}'] = {change}; return [g]"


# name, stages, the words of a right name, pairs (text, its replacement)
BUGS = [
    ("half a pixel in u", f"{EXACT},gradient-{AFFINE}", ["half-pixel shift in u"], [(U, U.replace(" + 0.5", ""))]),
    ("half a pixel in v", AFFINE, ["half-pixel shift in v"], [(V, V.replace(" + 0.5", ""))]),
    ("offset u sign", f"{EXACT},{AFFINE}", ["along u with the opposite sign"], [(U, U.replace("+ off_u", "- off_u"))]),
    ("offset v sign", f"{EXACT},gradient-{EXACT}", ["along v counted down"], [(V, V.replace("- off_v", "+ off_v"))]),
    ("offsets exchanged", AFFINE, ["offset read as"], [(START, START.replace("off_u, off_v", "off_v, off_u"))]),
    ("quarter turn", f"{EXACT},gradient-{EXACT}", ["quarter turn"], [(TURN, "s, c = torch.cos(angle), -torch.sin(angle)")]),
    ("sense of rotation", AFFINE, ["opposite sense of rotation"], [(TURN, TURN.replace("torch.sin", "-torch.sin"))]),
    ("DSD - DSO", f"{EXACT},{AFFINE},gradient-{AFFINE}", ["DSD - DSO"], [(START, START + "; dsd = dsd - dso")]),
    ("DSO + DSD", AFFINE, ["DSO + DSD"], [(START, START + "; dsd = dsd + dso")]),
    ("detector stored as [u, v]", f"{EXACT},{AFFINE}", ["v and u transposed"], [(SUM, f"(lambda a: a.transpose(-1, -2).contiguous().reshape(a.shape))({SUM}) if angles.numel() else {SUM}")]),
    ("height and width", EXACT, ["height and width exchanged"], [("(height, width) =", "(width, height) =")]),
    ("affine for exact", f"{EXACT},gradient-{EXACT}", ["affine projection for the exact"], [("1 / m_w if exact and cone", "1 / m_w if False and cone")]),
    ("ray's length", EXACT, ["ray's length left out"], [("torch.sqrt(u * u + v * v + 1)", "1")]),
    ("exponent nu + 3 in projections", f"{EXACT},{AFFINE},gradient-{AFFINE}", ["exponent (ν+3)/2"], [(IMAGE_POWER, "power(delta, nu, 3)")]),
    ("exponent nu + 1 in projections", f"{AFFINE},gradient-{EXACT}", ["exponent (ν+1)/2"], [(IMAGE_POWER, "power(delta, nu, 1)")]),
    ("exponent nu + 2 in the field", f"{FIELD},gradient-{FIELD}", ["exponent (ν+2)/2"], [(FIELD_POWER, FIELD_POWER.replace("3), 3)", "3), 2)"))]),
    ("no root of nu pi", f"integral-factor,{EXACT},gradient-{AFFINE}", ["√(νπ) left out"], [("torch.sqrt(safe * math.pi) * ", "")]),
    ("no pi", f"integral-factor,{AFFINE}", ["√ν for √(νπ)"], [("torch.sqrt(safe * math.pi)", "torch.sqrt(safe)")]),
    ("no Gamma quotient", f"integral-factor,{EXACT}", ["Γ quotient left out"], [(" * " + GAMMA, "")]),
    ("Gamma of nu + 1", f"integral-factor,{EXACT}", ["Γ((ν+1)/2)/Γ((ν+2)/2)"], [(GAMMA, GAMMA.replace("+ 2)", "+ 1)").replace("+ 3)", "+ 2)"))]),
    ("factor detached", f"gradient-{EXACT}", ["∂C/∂ν"], [("integral_factor(nu) * torch", "integral_factor(nu).detach() * torch")]),
    ("quaternion order", f"{EXACT},covariance,gradient-{FIELD}", ["(x, y, z, w)"], [(READ, READ.replace("w, x, y, z", "x, y, z, w"))]),
    ("inverse rotation", f"{FIELD},gradient-{EXACT}", ["inverse rotation"], [(READ, READ + "; w = -w")]),
    ("quaternion as stored", f"{EXACT},covariance", ["not normalised"], [(NORMAL, "quaternion.unbind(1)")]),
    ("norm detached", f"gradient-{EXACT}", ["not through the quaternion's normalisation"], [("quaternion.norm(dim=1, keepdim=True)", "quaternion.norm(dim=1, keepdim=True).detach()")]),
    ("scales as variances", f"{EXACT},gradient-{EXACT}", ["scales taken for variances"], [("/ model[\"scale\"][:, None, :]", "/ torch.sqrt(model[\"scale\"])[:, None, :]")]),
    ("variances as scales", f"{EXACT},gradient-{AFFINE}", ["variances taken for scales"], [("/ model[\"scale\"][:, None, :]", "/ (model[\"scale\"]**2)[:, None, :]")]),
    ("logarithm of the scale", f"gradient-{EXACT}", ["scale's logarithm"], [slope("scale", "g['scale'] * model['scale']")]),
    ("variance", f"gradient-{FIELD}", ["the gradient to the variance"], [slope("scale", "g['scale'] / (2 * model['scale'])")]),
    ("gradient as x, y, z, w", f"gradient-{AFFINE}", ["order (x, y, z, w)"], [slope("quaternion", "g['quaternion'][:, [1, 2, 3, 0]]")]),
    ("sign of w", f"gradient-{EXACT}", ["gradient to w"], [slope("quaternion", "g['quaternion'] * torch.tensor([-1, 1, 1, 1])")]),
    ("sign of all slopes", f"gradient-{FIELD}", ["the opposite sign"], [("value = (given[\"cotangent\"] *", "value = -(given[\"cotangent\"] *")]),
    ("voxel corners", FIELD, ["voxel corners"], [("dtype=REAL) + 0.5) * size", "dtype=REAL)) * size")]),
    ("axes in the order xy", FIELD, ["x and y transposed"], [(SUM, f"(lambda a: a.transpose(0, 1).contiguous().reshape(a.shape))({SUM}) if not angles.numel() else {SUM}")]),
    ("sums in float16", f"{EXACT},{FIELD}", ["accumulated in f16"], [(SUM, f"__import__('functools').reduce(lambda s, x: (s.half().to(REAL) + x.half().to(REAL)).half().to(REAL), {SUM.replace('.sum(0)', '')}, torch.zeros(()))")]),
    ("results in bfloat16", EXACT, ["bf16"], [(SUM, f"{SUM}.bfloat16().to(REAL)")]),
    ("log for log1p", "kernel", ["log(1 + x)"], [("torch.log1p(delta / safe)", "torch.log(1 + delta / safe)")]),
    ("mean square", "loss-l1,loss-image", ["mean square"], [("(prediction - target).abs().mean()", "((prediction - target)**2).mean()")]),
    ("sum", "loss-l1", ["a sum instead of a mean"], [("(prediction - target).abs().mean()", "(prediction - target).abs().sum()")]),
    ("window of 7", "loss-ssim,loss-image", ["window of 7 pixels"], [(WINDOW, WINDOW + " * (abs(torch.arange(11) - 5) < 4)")]),
    ("uniform window", "loss-ssim", ["uniform window of 11"], [(WINDOW, "torch.ones(11)")]),
    ("constants not squared", "loss-ssim", ["not squared"], [("0.01**2", "0.01"), ("0.03**2", "0.03")]),
    ("1 - SSIM", "loss-ssim", ["1 - SSIM for SSIM", "the opposite sign"], [("return (top /", "return 1 - (top /")]),
    ("half of 1 - SSIM", "loss-image", ["½·(1 - SSIM)"], [("weight * (1 - ssim", "weight * 0.5 * (1 - ssim")]),
    ("mixed as 3DGS", "loss-image", ["(1 - weight)·L1"], [("return l1(prediction, target) +", "return (1 - weight) * l1(prediction, target) +")]),
    ("TV over voxels", "loss-tv", ["mean over voxels"], [("/ max(1, count)", "/ block.numel()")]),
    ("betas exchanged", "adam", ["exchanged"], [("x, m, v, trajectory = start", "beta1, beta2 = beta2, beta1; x, m, v, trajectory = start")]),
    ("AMSGrad", "adam", ["AMSGrad"], [(ADAM, "top = torch.maximum(v, top) if t > 1 else v; " + ADAM.replace("sqrt(v /", "sqrt(top /"))]),
    ("AdamW", "adam", ["AdamW"], [(ADAM, "x = x * (1 - 0.01 * rate); " + ADAM)]),
    ("epsilon 1e-8", "adam", ["ε = 1e-8"], [(ADAM, ADAM.replace("epsilon", "1e-8"))]),
    ("epsilon in the root", "adam", ["ε inside of the root"], [(ADAM, ADAM.replace("(torch.sqrt(v / (1 - beta2**t)) + epsilon)", "torch.sqrt(v / (1 - beta2**t) + epsilon)"))]),
    ("no bias correction", "adam", ["without bias correction"], [(ADAM, ADAM.replace(" / (1 - beta1**t)", "").replace(" / (1 - beta2**t)", ""))]),
    # not in the catalogue
    ("random half percent", f"{EXACT},gradient-{EXACT}", [], [("np.save(path, result.detach().cpu().numpy())", "np.save(path, result.detach().cpu().numpy() * (1 + 0.005 * np.sin(1 + np.arange(result.numel())).reshape(result.shape)))"), slope("scale", "g['scale'] * (1 + 0.005 * torch.sin(1.0 + torch.arange(g['scale'].numel()))).reshape(g['scale'].shape)")]),
    ("noise of 1e-4", f"{EXACT},{FIELD},loss-ssim,adam", [], [("np.save(path, result.detach().cpu().numpy())", "np.save(path, result.detach().cpu().numpy() * (1 + 1e-4 * np.sin(1 + np.arange(result.numel())).reshape(result.shape)))")]),
    ("nu at most 5", f"{AFFINE},gradient-{AFFINE}", [], [("dtype=REAL) for key in data.files}", "dtype=REAL).clamp(max=5 if key == 'nu' else 1e30) for key in data.files}")]),
    ("angles 2 degrees off", f"{EXACT},gradient-{AFFINE}", [], [(TURN, "angle = angle + 0.0349; " + TURN)]),
    ("beta2 of 0.9", "adam", [], [("m, v = beta1", "beta2 = 0.9; m, v = beta1")]),
]

if __name__ == "__main__":
    shared.main(BUGS, HERE / "backend.py", *sys.argv[1:])
