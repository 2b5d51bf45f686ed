@echo off
rem Builds kinect_v2.exe with the compiler of .NET Framework, which every Windows has.
setlocal
cd /d "%~dp0"
set CSC=%WINDIR%\Microsoft.NET\Framework64\v4.0.30319\csc.exe
if not defined KINECTSDK20_DIR (
  echo The Kinect for Windows SDK 2.0 is not installed.
  exit /b 1
)
set KINECT=%KINECTSDK20_DIR%Assemblies\Microsoft.Kinect.dll
if not exist "%KINECT%" (
  echo "%KINECT%" is missing; install the Kinect for Windows SDK 2.0.
  exit /b 1
)
"%CSC%" /nologo /optimize /platform:x64 /target:exe /out:kinect_v2.exe "/reference:%KINECT%" *.cs || exit /b 1
copy /y "%KINECT%" . >nul
echo kinect_v2.exe is ready. Start it: kinect_v2 front
