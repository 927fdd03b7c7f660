function trial = read_result(path)
% READ_RESULT Read curves and displacements of a result of fingerflow, in MATLAB or Octave.
%
%   trial = read_result('result.h5') reads the file that `fingerflow process` writes: HDF5/NetCDF4. Octave needs its
%   package netcdf. `fingerflow outputs` lists all variables with unit and definition; ncdisp(path) those of the file.
%
%   MATLAB has the dimensions in reverse: displacement(component, point, frame). Numbers of points and frames count
%   from 0 in the file; `fingerflow export-table result.h5 result.mat` writes them from 1.

if exist('OCTAVE_VERSION', 'builtin')
    pkg load netcdf
end
trial.time = ncread(path, 'time');                            % s
trial.contact = ncread(path, 'gross_contact_area');           % mm^2
trial.divergence = 1e3 * ncread(path, 'median_divergence');   % um/mm
trial.displacement = 1e3 * ncread(path, 'displacement');      % um, 2 x points x frames
tracked = ncread(path, 'status') == 0;                        % points x frames

length_um = squeeze(sqrt(sum(trial.displacement .^ 2, 1)));
length_um(~tracked | isnan(length_um)) = 0;
[trial.farthest, trial.farthest_point] = max(length_um, [], 1);

fprintf('%d frames, %d points\n', numel(trial.time), size(tracked, 1));
fprintf('largest contact %.3f mm^2, largest displacement %.1f um\n', max(trial.contact), max(trial.farthest));
end
