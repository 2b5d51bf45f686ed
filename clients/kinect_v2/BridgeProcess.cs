// Starts `mocapella node bridge` beside this program, and starts it again when it has ended.
using System;
using System.ComponentModel;
using System.Diagnostics;

namespace Mocapella.KinectV2
{
    public sealed class BridgeProcess : IDisposable
    {
        private const int AgainAfterMs = 5000, EndMs = 20000;

        private readonly string program, arguments;
        private readonly Action<string> say;
        private Process process;
        private long startedMs = long.MinValue / 2;
        private bool told;

        /// <param name="program">The program mocapella: a name in PATH, or a path.</param>
        /// <param name="connect">Address of the server, pairing code or file with one; empty for this machine.</param>
        public BridgeProcess(string program, string host, int port, string connect, Action<string> say)
        {
            this.program = program;
            this.say = say;
            arguments = "node bridge --listen " + host + ":" + port;
            if (connect != "") arguments += " --connect \"" + connect + "\"";
        }

        /// <summary>Start it, unless it runs or was started within the last seconds.</summary>
        public void Ensure()
        {
            long now = MonotonicClock.NowNs() / 1000000;
            if (process != null && !process.HasExited || now - startedMs < AgainAfterMs) return;
            if (process != null) say("the bridge has ended; starting it again");
            startedMs = now;
            var how = new ProcessStartInfo(program, arguments)
            {
                UseShellExecute = false,
                CreateNoWindow = true, // and a console of its own: Ctrl+C does not end it before the last frame
                RedirectStandardInput = true,
                RedirectStandardError = true,
            };
            how.EnvironmentVariables["MOCAPELLA_STARTED_BY_US"] = "1"; // it ends when its standard input does
            try
            {
                process = Process.Start(how);
                process.ErrorDataReceived += (source, line) => { if (line.Data != null) say(line.Data); };
                process.BeginErrorReadLine();
            }
            catch (Win32Exception error)
            {
                process = null;
                if (!told)
                    say("cannot start " + program + " (" + error.Message + "); install Mocapella, or say where it is"
                        + " with --mocapella PATH, or start it yourself: mocapella node bridge");
                told = true;
            }
        }

        /// <summary>End it and wait.</summary>
        public void Dispose()
        {
            if (process == null) return;
            try
            {
                process.StandardInput.Close();
                process.WaitForExit(EndMs);
            }
            catch (InvalidOperationException)
            {
                // It has ended already.
            }
        }
    }
}
