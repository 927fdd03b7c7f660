// ImageJ macro: the mean of a map in each frame, as a table beside it.
//
// ImageJ reads no HDF5 by itself, so the map of a variable of a result is exported first:
//     fingerflow export-map result.h5 divergence divergence.tif
//     ImageJ -batch measure_map.ijm divergence.tif
// The stack has the scale in mm, the interval of the frames in s, NaN where nothing is known, and its unit in the first
// line of Image > Show Info.
path = getArgument();
if (path == "") path = File.openDialog("A map of fingerflow");
setBatchMode(true);
open(path);
Stack.getDimensions(width, height, channels, slices, frames);
getPixelSize(unit, step, step_y);
interval = Stack.getFrameInterval();
lines = "frame,time (s),area (" + unit + "^2),mean\n";
for (frame = 1; frame <= frames; frame++) {
    Stack.setFrame(frame);
    sum = 0; count = 0;
    for (y = 0; y < height; y++) for (x = 0; x < width; x++) {
        value = getPixel(x, y);
        if (!isNaN(value)) { sum += value; count++; }
    }
    mean = NaN;
    if (count > 0) mean = sum / count;
    lines += "" + frame - 1 + "," + d2s((frame - 1) * interval, 6) + "," + d2s(count * step * step, 6) + "," + d2s(mean, 6) + "\n";
}
File.saveString(lines, replace(path, ".tif", ".csv"));
