"""Texts of the report page of a pair, which the plugin writes in the language of QGIS."""

from __future__ import annotations

from .text import mark

LANGUAGE = mark("en")
"""The language that the engine writes in; translated, that of QGIS."""
PAGE = (
    # Headings and verdicts
    mark("Registered"),
    mark("Registered, with care"),
    mark("Registered, poorly"),
    mark("{}, but a requirement is not met"),
    mark("Matched"),
    mark("Could not be registered reliably"),
    mark("Tie points matched"),
    mark("Registered: {} to {}"),
    mark("Registered, with care: {} to {}"),
    mark("Registered, poorly: {} to {}"),
    mark("Could not be registered reliably: {} to {}"),
    mark("Tie points matched: {} to {}"),
    mark("{}, but a requirement is not met: {} to {}"),
    mark("({}) to"),
    mark("({})"),
    mark("Before and after"),
    mark("The whole scene"),
    mark("Numbers"),
    mark("Tie points"),
    mark("Coverage"),
    mark("Residuals"),
    mark("Jitter and stripes"),
    mark("Predicted sigma of the correction"),
    mark("The tool's own error on this pair"),
    mark("The tool's own error: {} to {}"),
    mark("On this pair the matching itself errs by {} px"),
    mark("90 % of the tie points, moved by known amounts:"),
    mark("All figures:"),
    mark("Warp it yourself"),
    mark("Files"),
    mark("Inputs, settings and versions"),
    mark("When the figures are bad: what to do"),
    mark("Requirements"),
    # Answers
    mark("After correction by the {} model, 90 % of the {} lie within"),
    mark("{} check points, which the fit has not seen,"),
    mark("{} fit points (there were too few to hold some out)"),
    mark("of where the target shows them."),
    mark("How well?"),
    mark("CE90 {} before, {} after the correction"),
    mark("; nearly all of what is left is noise of the matching itself."),
    mark("; {} of it once the noise of the matching is taken out."),
    mark("90 % of the {} is expected to lie within {}"),
    mark("common ground"),
    mark("ground that was compared"),
    mark(", and of all that both show within {}."),
    mark("All this is relative to the basemap {}"),
    mark("{} m a pixel, fetched {}"),
    mark("The correction improves nothing."),
    mark("Where not?"),
    mark("{} of the target lies beyond the tie points (hatched below)"),
    mark("Less than {} of the target lies beyond the tie points (hatched below)"),
    mark("{} of the image has no tie point near (see Coverage)"),
    mark("Less than {} of the image has no tie point near (see Coverage)"),
    mark("less than {} of the image has no tie point near (see Coverage)"),
    mark("Tie points cover the whole common area."),
    mark("less than 1 %"),
    mark("Can I trust the figure?"),
    mark("With care: there were too few points to keep some out of the fit."),
    mark("With care:"),
    mark("only {} check points, {} are asked for (ASPRS 2023)"),
    mark("check points are much worse than fit points: the model does not hold between its points"),
    mark("there are warnings below"),
    mark("Yes: it is counted at {} check points that the fit has not seen."),
    mark("No corrected raster was written, as a requirement is not met; the option"),
    mark("writes it all the same."),
    # Views
    mark(
        "The reference is red, the target cyan. Where both are equally bright and fit, the sum is grey. A "
        "red and a cyan line side by side is a step. Bands of other contrast stay coloured: look at the "
        "lines."
    ),
    mark("How the whole scene is shown"),
    mark("Red and cyan"),
    mark("Edges of the reference on the target"),
    mark("Edges of the reference"),
    mark("Before the correction"),
    mark("After the correction"),
    mark("The reference"),
    mark("{}, the target on the same ground"),
    mark(
        "Left of the line is the reference, right of it the target. Edges that cross the line must run on "
        "without a step. Move the line with the mouse, or with the arrow keys when the slider is chosen. In"
        " print both are a checkerboard."
    ),
    mark(
        "Reference and target alternate in the squares of a checkerboard. Edges must run on from square to "
        "square without a step."
    ),
    mark("{} more place"),
    mark("{} more places"),
    mark("the middle"),
    mark("the clearest edge"),
    mark("the most distinct match"),
    mark("the largest residual"),
    mark("a clear edge, {}"),
    mark("in the middle"),
    mark("upper left"),
    mark("upper middle"),
    mark("upper right"),
    mark("middle left"),
    mark("middle right"),
    mark("lower left"),
    mark("lower middle"),
    mark("lower right"),
    mark("Around reference column {}, row {}; {} target px wide."),
    mark("Line"),
    mark("Checkerboard"),
    mark("Line between reference and target, {}"),
    # Figures
    mark("These are figures of a refused pair: they say what was found, not where the target lies."),
    mark("There is no tie point to count."),
    mark("Statistics per axis"),
    mark("Radial statistics"),
    mark("Per axis, target px"),
    mark("Radial"),
    mark("Points"),
    mark("axis"),
    mark("unit"),
    mark("mean"),
    mark("median"),
    mark("std"),
    mark("net RMSE"),
    mark("net CE90"),
    mark("net CE95"),
    mark("Before, all points: displacement"),
    mark("After, fit points: residual"),
    mark("After, check points: residual"),
    mark("column"),
    mark("row"),
    mark("({} points)"),
    mark("target px"),
    mark("native px"),
    mark("metres"),
    mark(
        "LE90 is the 90th percentile of the absolute error along an axis; CE90 and CE95 are the 90th and "
        "95th percentile of its length, counted, not derived from a normal distribution. Net: without the "
        "noise of the matching, known from the sigma of each point"
    ),
    mark("({} px in column, {} px in row)"),
    mark("; it is a good figure only as far as those sigmas are."),
    mark("The native pixel, which the coarser of the two sensors recorded, is {} m."),
    mark("Median displacement on the map: {} m (x, y)."),
    mark(
        "Check points were kept out of the fit and of the choice of the model. They come from the same {}, "
        "so a bias that {} may have is not in these figures."
    ),
    mark("matcher"),
    mark("file"),
    mark("the matcher itself"),
    mark("its points"),
    mark(
        "Cross-validated RMSE of each correction model with two standard errors; the figures are in the "
        "table below."
    ),
    mark(
        "Each model is fitted without a part of the scene and judged there. The simplest that no other "
        "beats is chosen."
    ),
    mark("Correction model"),
    mark("parameters"),
    mark("cross-validated RMSE, px"),
    mark("cross-validated RMSE, target px"),
    mark("chosen"),
    mark("{} (chosen)"),
    mark("{} predicts better"),
    mark("not tried: {} is chosen"),
    mark("not tried: {}, which needs no resampling, is not beaten"),
    mark("does not predict significantly better than {}"),
    mark("differs from {} by no more than its uncertainty"),
    mark("The points are those of the file {}; nothing was matched."),
    mark("Arrows point where the target shows the ground, from where its georeferencing puts it."),
    mark("After a good correction hardly anything is left to see on the right."),
    mark("{} total, {} fit, {} check, {} unused, {} rejected."),
    mark("{} total, {} matched, {} rejected."),
    mark("Candidates and what became of them"),
    mark("count"),
    mark("tiles"),
    mark("candidates"),
    mark("not comparable"),
    mark("not similar"),
    mark("at search border"),
    mark("not converged"),
    mark("directions disagree"),
    mark("second try"),
    mark("inconsistent"),
    mark("consistent"),
    mark("matched"),
    mark("tie points"),
    # Coverage
    mark("In squares without tie points the correction is not checked."),
    mark("Why there are no tie points:"),
    mark("Every square has tie points."),
    mark("no data"),
    mark("one of the two has no data there (nodata, masked, outside): nothing can be matched"),
    mark("at an edge"),
    mark("too near to an edge or to masked pixels: a smaller --window and --template reach further"),
    mark("unreadable"),
    mark("the file is damaged there"),
    mark("not asked for"),
    mark("no window was laid there, as enough points were found elsewhere: --points all asks for more"),
    mark("no structure"),
    mark("flat ground, such as water: another band or date may show more"),
    mark("beyond the search"),
    mark(
        "most best matches lie on the border of the search: the displacement may be larger (raise "
        "--search-radius), or clouds hide the ground"
    ),
    mark("no match"),
    mark("what is seen is too different, or repeats: clouds, change, another kind of band"),
    mark("rejected"),
    mark("there were matches, but they contradict their neighbours: clouds, water, moving things"),
    # Legends of the figures
    mark(
        "Short arrows in all directions are noise. Arrows that run in one direction over an area tell of "
        "relief, parallax or a model that is too simple there."
    ),
    mark(
        "Bell shapes around zero are good; a dashed line off zero is a bias, two humps are two populations "
        "(two sensor strips, ground and clouds). Grey dots are fit points, rings check points; 90 % lie "
        "within the circle."
    ),
    mark(
        "Black: means of a twelfth of the range with two standard errors. They should stay around zero: "
        "waves or slopes depend on the place, so the model misses something (sensor jitter, relief, too "
        "simple a model)."
    ),
    mark(
        "Displacement (before the correction) of whole rows and columns, less a smooth trend; shaded: 95 % "
        "confidence. Bands that hold zero throughout show nothing. A wave is called jitter where chance "
        "makes one as strong in less than one of a thousand images;"
    ),
    mark("takes it out."),
    mark("Median {} px (column, row), largest {} px."),
    mark(
        "{} of the target, hatched, lie beyond the tie points: there the correction is continued, and sigma"
        " says only how well the model is determined."
    ),
    mark("A thin-plate spline through the tie points, run in this folder:"),
    mark("before: displacement"),
    mark("after: residual, same scale"),
    mark("{} target px"),
    mark("reference column, px"),
    mark("reference row, px"),
    mark("target column, px"),
    mark("target row, px"),
    mark("column, target px"),
    mark("row, target px"),
    mark("residual, target px"),
    mark("residual, enlarged"),
    mark("check point"),
    mark("check"),
    mark("fit and check"),
    mark("residual in {}, target px"),
    mark("residual in {}, px"),
    mark("in {}, px"),
    mark("in row"),
    mark("in column"),
    mark("points"),
    mark("displ., px"),
    mark("height, m"),
    mark("By height"),
    mark("Along the {}s: no wave beyond chance"),
    mark("Along the {}s: jitter of {}"),
    mark("{} px in {}, period {} px"),
    mark("predicted sigma, target px"),
    # The tool's own error
    mark("How large is its own error?"),
    mark("90 % of the points lie within {} px"),
    mark(", 90 % of the correction within {} px."),
    mark("Does it lock to whole pixels?"),
    mark("Its errors follow the fraction of a pixel by {} px, and scatter by {} px."),
    mark("Do the sigmas hold?"),
    mark("{} % of the errors lie within sigma (68 is right)"),
    mark(": they would have to be {} times as large."),
    mark(", which leaves room for errors that no proof shows."),
    mark("Do wrong matches get through?"),
    mark("{} of {} passed every test."),
    mark("What would a blind spot cost?"),
    mark("Without the tie points of a ninth of the scene the {} there would change by up to"),
    mark("What does it tolerate?"),
    mark("a displacement of {} px"),
    mark("a rotation of {} degrees"),
    mark("fresh noise of {} times the standard deviation of the images"),
    mark("clouds over a share of {} of the target"),
    mark("A displacement of {} px"),
    mark("Not even"),
    mark("not even"),
    mark("or more"),
    mark("beyond, it was refused"),
    mark("{} results beyond were accepted, and wrong"),
    mark("Do both directions agree?"),
    mark("Points return to {} px (RMS) from where they began."),
    mark(
        "These figures show pixel locking, interpolation and noise. They do not show edges that lie "
        "elsewhere in the other band, such as shadows: allow up to {} px for them. Halves of the evidence "
        "differ by {} px or more, which is a lower bound. A third band shows more: the triangle of the "
        "three must close."
    ),
    mark(
        "The target was moved by {} known amounts and matched again at {} tie points, with fresh noise. "
        "Left: what the matching missed the known moves by. Right: flat lines within the grey band are "
        "good; a wave means that it is drawn to whole pixels."
    ),
    mark(
        "A part of {} x {} px was made harder by and by and registered as any pair is. Grey: no longer "
        "tolerated."
    ),
    mark("Errors by kind"),
    mark("Errors, target px"),
    mark("matches"),
    mark("mean, column"),
    mark("scatter, column"),
    mark("structure: {}"),
    mark("move: shift"),
    mark("move: turn"),
    mark("move: field"),
    mark("window: {}"),
    mark("faintest quarter"),
    mark("second quarter"),
    mark("third quarter"),
    mark("strongest quarter"),
    mark("Independent evidence"),
    mark("Two halves of the evidence, target px"),
    mark("differ by, column"),
    mark("± column"),
    mark("channels"),
    mark("windows"),
    mark("directions"),
    mark("errors; 90 % within {} px"),
    mark("fraction of the displacement, px"),
    mark("mean error along a pixel; a wave is pixel locking"),
    mark("error of one match, RMS, target px"),
    mark("where the matching errs"),
    mark("displacement, px"),
    mark("rotation, degrees"),
    mark("noise, standard deviations"),
    mark("clouds, share of the target"),
    mark("what a part of the pair tolerates (dot: right, x: refused, x in a ring: wrong; dots: as it lies)"),
    # Advice
    mark("Too few points"),
    mark(
        "The overlap is small, flat or masked, or the bands show different things. Choose bands alike in "
        "what they show (red and red, near infrared and near infrared), check masks and nodata, ask for "
        "more points ("
    ),
    mark("), or lower"),
    mark("for small images."),
    mark("Clouds"),
    mark("Squares without points or with rejected ones only, over bright areas. Give a cloud mask ("),
    mark(": QA_PIXEL, SCL or zeros) or another date."),
    mark("Wrong search radius"),
    mark(
        "Many candidates “at search border”, or a refusal. The displacement is larger than the radius: raise"
    ),
    mark("(the whole image was searched already)"),
    mark(", or give"),
    mark("Relief"),
    mark(
        "Residuals grow with the slopes and change sign across a ridge. The images were not corrected for "
        "terrain, or by another elevation model: orthorectify both with the same one, or try"
    ),
    mark("Parallax of another sensor"),
    mark(
        "Residuals run along one direction, in stripes across the track, or clouds and moving things are "
        "displaced and the ground is not. Detectors look at slightly different angles and times; no smooth "
        "model takes that out."
    ),
    mark("Check points worse than fit points"),
    mark("The model follows its points and fails between them: take a simpler one ("),
    mark(") or more points."),
    mark("A trend over column or row"),
    mark("The model is too simple for the sensor:"),
    mark("or"),
    # What was given and used
    mark("reference"),
    mark("target"),
    mark("pre-alignment"),
    mark("geometry found"),
    mark("{}, shift {} px, search radius {} px; matched by {}"),
    mark("georeferencing"),
    mark("identity"),
    mark("structure"),
    mark("grey values"),
    mark(", shift {} px, search radius {} px; matched by {}"),
    mark("(evidence {} of at most 4, start {})"),
    mark(", scale expected by the cameras {}"),
    mark("planar"),
    mark(": the tie points lie {} px (RMS) across the epipolar lines"),
    mark(", and {} px along them beside what one plane gives"),
    mark("from {};"),
    mark("heights from {}, {} m up to the ellipsoid"),
    mark("ground taken to be {} m above the ellipsoid"),
    mark("; error of the corrected coefficients {} px"),
    mark(", matrix {}"),
    mark("(report.json holds it in full)"),
    mark("model"),
    mark("no CRS"),
    mark("{}, {} of {}, {} × {} px, {}, {}"),
    mark("band {}"),
    mark("default"),
    mark("seconds, {}"),
    mark("reading"),
    mark("matching"),
    mark("refining"),
    mark("fitting"),
    mark("proving"),
    mark("writing"),
    mark("report"),
    mark("warping"),
    # What pictures show, for those who do not see them
    mark(
        "Map of the {} tie points on the reference image: arrows for the displacement of each before the "
        "correction"
    ),
    mark(", and beside it the residual after it on the same scale"),
    mark("Median displacement {} px (column, row)."),
    mark("Map of the number of tie points in each square of the reference image."),
    mark("Squares without any:"),
    mark("Every square has some."),
    mark(
        "Map of the residuals on the reference image, arrows enlarged and coloured by length, with rings on"
        " the check points and crosses on rejected points."
    ),
    mark(
        "Histograms of the residuals in column and in row, and the residuals as points with the circle of "
        "CE90."
    ),
    mark(
        "Residuals in column and row against target column, row and, where an elevation model was given, "
        "height, with means of stretches."
    ),
    mark(
        "Displacement along the columns and the rows of the target, and by height where an elevation model "
        "was given, less its smooth trend, with 95 % confidence bands."
    ),
    mark(
        "Map of the predicted radial sigma of the correction over the target, with the tie points of the "
        "fit; places beyond the tie points are hatched."
    ),
    mark(
        "Left: the errors of the points, column and row, with the circle that holds 90 % of them. Right: "
        "their mean by the fraction of a pixel of the displacement."
    ),
    mark("Map of the error of each point on the reference."),
    mark(
        "Tie points that are kept as a part of the pair is made harder: by displacement, rotation, noise "
        "and clouds."
    ),
)
"""Texts, whole or parts of some; values stand in `{}`. A test compares them with the engine."""
