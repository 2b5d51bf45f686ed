// The Kinect v2 as a sensor of Mocapella. README.md says how to build and start it.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Runtime.InteropServices;
using System.Security.Cryptography;
using System.Text.RegularExpressions;
using System.Threading;

namespace Mocapella.KinectV2
{
    /// <summary>What the command line says.</summary>
    public sealed class Options
    {
        public string Sensor, Host = "127.0.0.1", Connect = "", Mocapella = "mocapella", Spool = "";
        public int Port = 7450;
        public long SpoolMib = 1024, ReserveMib = 1024, Frames = long.MaxValue;
        public bool StartBridge = true;

        public const string Usage = @"usage: kinect_v2 SENSOR [OPTION VALUE]...

SENSOR is a name of your choice, such as front.

  --connect ADDRESS     server: tls/192.0.2.7:7447, a pairing code, or a file with one; left out: this machine
  --bridge HOST:PORT    where mocapella node bridge listens (127.0.0.1:7450); it is started if nothing does
  --start-bridge yes|no whether to start it (yes)
  --mocapella PATH      the program mocapella, if it is not in PATH
  --spool FOLDER        folder of frames that no server has stored yet
  --spool-mib MIB       largest size of these (1024); then the oldest are lost
  --reserve-mib MIB     free disk space to leave (1024)
  --frames NUMBER       end after so many frames";

        /// <summary>Read a command line; throws ArgumentException with what is wrong.</summary>
        public static Options Of(string[] words)
        {
            if (words.Length == 0) throw new ArgumentException("the name of the sensor is missing");
            var options = new Options { Sensor = words[0] };
            if (!Regex.IsMatch(options.Sensor, @"\A[A-Za-z0-9][A-Za-z0-9_.-]{0,63}\z"))
                throw new ArgumentException("sensor name " + words[0] + " cannot be used; take 1 to 64 letters, "
                    + "digits, '_', '-' or '.', beginning with a letter or digit");
            for (int i = 1; i < words.Length; i += 2)
            {
                if (i + 1 == words.Length) throw new ArgumentException(words[i] + " wants a value");
                string value = words[i + 1];
                switch (words[i])
                {
                    case "--connect": options.Connect = value; break;
                    case "--mocapella": options.Mocapella = value; break;
                    case "--spool": options.Spool = value; break;
                    case "--spool-mib": options.SpoolMib = Number(words[i], value, 1); break;
                    case "--reserve-mib": options.ReserveMib = Number(words[i], value, 0); break;
                    case "--frames": options.Frames = Number(words[i], value, 1); break;
                    case "--start-bridge": options.StartBridge = YesOrNo(words[i], value); break;
                    case "--bridge":
                        int colon = value.LastIndexOf(':');
                        if (colon < 1) throw new ArgumentException("--bridge wants HOST:PORT, such as 127.0.0.1:7450");
                        options.Host = value.Substring(0, colon);
                        options.Port = (int)Number(words[i], value.Substring(colon + 1), 1, 65535);
                        break;
                    default: throw new ArgumentException("there is no option " + words[i]);
                }
            }
            if (options.Spool == "")
            {
                string data = Environment.GetFolderPath(Environment.SpecialFolder.LocalApplicationData);
                options.Spool = Path.Combine(data, "mocapella", "kinect_v2");
            }
            return options;
        }

        private static long Number(string option, string value, long least, long most = 1000000000)
        {
            long number;
            if (!long.TryParse(value, NumberStyles.None, CultureInfo.InvariantCulture, out number)
                || number < least || number > most)
                throw new ArgumentException(option + " is " + value + "; it wants " + least + " to " + most);
            return number;
        }

        private static bool YesOrNo(string option, string value)
        {
            if (value != "yes" && value != "no")
                throw new ArgumentException(option + " is " + value + "; it wants yes or no");
            return value == "yes";
        }
    }

    public static class Program
    {
        /// <summary>Wait at the end for the next acknowledgement [ms]; the bridge waits 10 s for the server.</summary>
        private const int FarewellMs = 15000;
        /// <summary>Windows ends a program whose window was closed after 5 s; the frames are on the disk.</summary>
        private const int CloseMs = 4500;
        private const int LeftTries = 5;

        private static readonly ManualResetEvent stop = new ManualResetEvent(false);
        private static readonly ManualResetEvent finished = new ManualResetEvent(false);
        private static CloseHandler onClose; // kept, because only native code refers to it

        private delegate bool CloseHandler(int kind);

        [DllImport("kernel32.dll")]
        private static extern bool SetConsoleCtrlHandler(CloseHandler handler, bool add);

        public static int Main(string[] words)
        {
            Options options;
            try
            {
                options = Options.Of(words);
            }
            catch (ArgumentException error)
            {
                Console.Error.WriteLine(error.Message + "\n\n" + Options.Usage);
                return 2;
            }
            Console.CancelKeyPress += (source, key) =>
            {
                key.Cancel = !stop.WaitOne(0); // the second one ends it at once
                stop.Set();
            };
            if (Path.DirectorySeparatorChar == '\\')
            {
                onClose = kind => // 2: the window is closed, 5: the user logs off, 6: the machine is shut down
                {
                    if (kind != 2 && kind != 5 && kind != 6) return false;
                    stop.Set();
                    finished.WaitOne(CloseMs);
                    return true;
                };
                SetConsoleCtrlHandler(onClose, true);
            }
            try
            {
                return Run(options);
            }
            catch (Exception error)
            {
                if (!(error is IOException || error is UnauthorizedAccessException)) throw;
                Say("PROBLEM: " + error.Message);
                return 1;
            }
            finally
            {
                finished.Set();
            }
        }

        private static void Say(string text)
        {
            lock (stop) Console.Error.WriteLine(text);
        }

        private static int Run(Options options)
        {
            var left = Spool.Left(options.Spool, options.Sensor, Say);
            long most = options.SpoolMib * 1048576, reserve = options.ReserveMib * 1048576;
            var spool = new Spool(options.Spool, options.Sensor, RandomId(), most, reserve, Say);
            spool.Earlier.AddRange(left);
            Say(options.Sensor + ": frames wait in " + options.Spool + ", at most " + options.SpoolMib
                + " MiB, until they are stored; then the oldest are lost (Ctrl+C ends)");
            long made = 0;
            Action<FrameValues> onFrame = frame =>
            {
                if (made >= options.Frames || stop.WaitOne(0)) return;
                frame.Sensor = options.Sensor;
                frame.NodeId = spool.NodeId;
                spool.Append(number => { frame.Sequence = (ulong)number; return BodyMessage.Encode(frame); });
                if (++made >= options.Frames) stop.Set();
            };
            int status = 0;
            Action<bool> onAvailable = there => Say(there ? "the Kinect runs" : "the Kinect is unplugged");
            using (var process = new BridgeProcess(options.Mocapella, options.Host, options.Port, options.Connect, Say))
            using (var sensor = new BodySensor(onFrame, onAvailable))
            {
                Action onNoBridge = () => { if (options.StartBridge) process.Ensure(); };
                var link = new BridgeLink(options.Host, options.Port, options.Sensor, Say, onNoBridge);
                var sender = new Thread(() => status = Send(link, left, spool)) { Name = "sender" };
                sender.Start();
                stop.WaitOne();
                sensor.Dispose(); // no frame comes afterwards
                sender.Join();
                Say(options.Sensor + ": " + spool.Next + " frames, " + link.Lost + " of them lost; the SDK did not "
                    + "give " + sensor.Missed + ", repeated " + sensor.Repeated + "; " + sensor.BadJoints
                    + " joints were no numbers; its clock went back " + sensor.ClockJumps + " times");
                if (spool.Dropped > 0) status = 1;
            }
            return status;
        }

        /// <summary>Deliver the frames of earlier runs, then those of this one; return the exit status.</summary>
        private static int Send(BridgeLink link, List<Spool> left, Spool spool)
        {
            int status = 0;
            foreach (var earlier in left)
            {
                Say("an earlier run left " + earlier.Waiting + " frames in " + earlier.Folder + "; sending them first");
                int refusals = link.Refusals;
                Func<long, bool> giveUp = Patience(() => link.Refusals - refusals >= LeftTries);
                bool stored = link.Deliver(earlier, () => true, giveUp);
                if (earlier.Dropped > 0) status = 1;
                if (stored)
                {
                    Say("the frames of the earlier run are stored");
                    earlier.Remove();
                    continue;
                }
                Say("PROBLEM: " + earlier.Waiting + " frames of an earlier run stay in " + earlier.Folder
                    + "; the next start sends them");
                earlier.Dispose();
                status = 1;
            }
            if (link.Deliver(spool, () => stop.WaitOne(0), Patience(() => false)))
            {
                spool.Remove();
                return status;
            }
            Say("PROBLEM: " + spool.Waiting + " frames are not stored; they stay in " + spool.Folder
                + ", and the next start sends them");
            spool.Dispose();
            return 1;
        }

        /// <summary>Return when to give up: some time after the end without a further acknowledgement, or for a reason.
        /// </summary>
        private static Func<long, bool> Patience(Func<bool> reason)
        {
            long best = -1, sinceMs = 0;
            return acknowledged =>
            {
                long now = MonotonicClock.NowNs() / 1000000;
                if (!stop.WaitOne(0) || acknowledged > best)
                {
                    best = acknowledged;
                    sinceMs = now;
                }
                return reason() || now - sinceMs > FarewellMs;
            };
        }

        private static ulong RandomId()
        {
            var bytes = new byte[8];
            using (var random = RandomNumberGenerator.Create()) random.GetBytes(bytes);
            return BitConverter.ToUInt64(bytes, 0) >> 1 | 1; // not 0, and below 2^63
        }
    }
}
